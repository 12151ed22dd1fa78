// node validate.mjs FILE.glb: prints, as JSON, what gltf-validator says of it, and what of its
// extras is not as docs/gltf.schema.json has it
import { readFile } from 'node:fs/promises';
import Ajv from 'ajv/dist/2020.js';
import validator from 'gltf-validator';

const bytes = new Uint8Array(await readFile(process.argv[2]));
const { issues } = await validator.validateBytes(bytes, { maxIssues: 0 });
const schema = new URL('../../docs/gltf.schema.json', import.meta.url);
const validate = new Ajv({ allErrors: true }).compile(JSON.parse(await readFile(schema)));
const length = new DataView(bytes.buffer, bytes.byteOffset).getUint32(12, true);
validate(JSON.parse(new TextDecoder().decode(bytes.subarray(20, 20 + length))));
const extras = (validate.errors ?? []).map((e) => `${e.instancePath} ${e.message}`);
console.log(JSON.stringify({ issues, extras }));
