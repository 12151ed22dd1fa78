// node babylon.mjs FILE.glb: prints, as JSON, what Babylon.js reads of every baked primitive:
// { name: { attributes: { _PRT_0: [...], … }, prt } }. The class is all that a reader needs.
import { readFile } from 'node:fs/promises';
import { createRequire } from 'node:module';

const require = createRequire(import.meta.url);
const BABYLON = require('babylonjs');
BABYLON.Logger.LogLevels = BABYLON.Logger.ErrorLogLevel;
const { GLTF2 } = require('babylonjs-loaders');

class Prt {
  constructor(loader) { Object.assign(this, { loader, name: 'PRT', enabled: true }); }

  async _loadVertexDataAsync(context, primitive, mesh) {
    const geometry = await this.loader._loadVertexDataAsync(context, primitive, mesh);
    for (const [name, index] of Object.entries(primitive.attributes)) {
      if (!name.startsWith('_PRT_')) continue;
      const accessor = this.loader.gltf.accessors[index];
      const buffer = await this.loader._loadVertexAccessorAsync(`/accessors/${index}`, accessor, name);
      geometry.setVerticesBuffer(buffer, accessor.count);
    }
    const { extras } = this.loader.gltf.meshes[/meshes\/(\d+)/.exec(context)[1]];
    geometry.prt = extras?.prt;
    return geometry;
  }

  dispose() { this.loader = null; }
}

GLTF2.GLTFLoader.RegisterExtension('PRT', (loader) => new Prt(loader));
const scene = new BABYLON.Scene(new BABYLON.NullEngine());
const file = `data:base64,${(await readFile(process.argv[2])).toString('base64')}`;
const { meshes } = await BABYLON.SceneLoader.ImportMeshAsync('', '', file, scene, null, '.glb');
const found = {};
for (const mesh of meshes) {
  const { geometry } = mesh;
  const names = geometry?.getVerticesDataKinds().filter((kind) => kind.startsWith('_PRT_')) ?? [];
  const values = (name) => Array.from(geometry.getVertexBuffer(name).getFloatData(geometry.getTotalVertices(), true));
  if (names.length) found[mesh.name] = { attributes: Object.fromEntries(names.map((name) => [name, values(name)])), prt: geometry.prt };
}
process.stdout.write(JSON.stringify(found), () => process.exit(0)); // the engine's timers go on
