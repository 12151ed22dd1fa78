// node validate.mjs FILE.glb: prints what gltf-validator says of it, as JSON
import { readFile } from 'node:fs/promises';
import validator from 'gltf-validator';

const bytes = new Uint8Array(await readFile(process.argv[2]));
const report = await validator.validateBytes(bytes, { maxIssues: 0 });
console.log(JSON.stringify(report.issues));
