// What is on the canvas: a model with its bakes, an environment, and how both are turned.
import * as THREE from 'three';
import { GLTFLoader } from 'three/addons/loaders/GLTFLoader.js';
import { OrbitControls } from 'three/addons/controls/OrbitControls.js';
import { decoded } from './atlas.js';
import { bakedMaterial, setLight } from './baked_material.js';
import * as environment from './environment.js';
import { ErrorView } from './error_view.js';
import { checkRoom, readBake, readLight } from './prt_file.js';
import { lightOfNode, terms } from './prt_light.js';
import { aboutY, rotate } from './sh.js';

const FOV = 35;
const GREY = [[2, 2, 2]]; // light of a file that has none

export class Stage {
  constructor(canvas) {
    this.renderer = new THREE.WebGLRenderer({ canvas, antialias: true });
    this.renderer.toneMapping = THREE.NoToneMapping;
    this.scene = new THREE.Scene();
    this.camera = new THREE.PerspectiveCamera(FOV, 1, 0.01, 1000);
    this.controls = new OrbitControls(this.camera, canvas);
    this.controls.enableDamping = true;
    this.pivot = new THREE.Group();
    this.scene.add(this.pivot);
    this.options = { albedo: true, bounces: true, residual: true, lights: true, background: true };
    this.view = 'baked';
    this.turns = { environment: 0, model: 0 };
    this.primitives = []; // { mesh, plain, baked, bake, direct: { baked, bake } }
    this.atlases = new Map();
    this.errorView = new ErrorView();
    this.light = null; // of the file
    this.picture = null; // { light, texture } of a dropped environment
  }

  // Shows the .glb in `buffer`; { baked, triangles, attributes, pictures, problems } of it, problems
  // being sentences. What cannot show its bake shows its plain material.
  async loadModel(buffer) {
    const gltf = await new GLTFLoader().parseAsync(buffer, '');
    this.#clear();
    this.#place(gltf.scene);
    const problems = this.#readLight(gltf.scene);
    const meshes = [];
    gltf.scene.traverse((mesh) => mesh.isMesh && meshes.push(mesh));
    for (const mesh of meshes) this.primitives.push(await this.#primitive(mesh, gltf.parser, problems));
    const bakes = this.primitives.flatMap((one) => one.bake ?? []);
    if (!bakes.length && !problems.length) problems.push('Nothing in this file is baked');
    this.#showEnvironment();
    this.update();
    return {
      baked: bakes.length,
      triangles: meshes.reduce((sum, { geometry: { index, attributes } }) => sum + (index ?? attributes.position).count / 3, 0),
      attributes: Math.max(0, ...bakes.map(({ images, layout }) => (images ? 0 : layout.length / 4))),
      pictures: new Set(bakes.flatMap(({ images }) => images ?? [])).size,
      problems: [...new Set(problems)],
    };
  }

  #readLight(scene) {
    try {
      this.light = readLight(scene.userData.prt_light);
      return [];
    } catch (error) {
      this.light = null;
      return [`Shown with its plain material: ${error.message}`];
    }
  }

  async #primitive(mesh, parser, problems) {
    const place = parser.associations.get(mesh);
    const document = parser.json.meshes[place.meshes];
    const plain = mesh.material;
    const prt = document.extras?.prt;
    if (!prt || !this.light) return { mesh, plain };
    try {
      const bake = readBake(prt, mesh.geometry, parser.json.images);
      const own = document.primitives[place.primitives ?? 0].material !== undefined;
      const make = (its) => this.#baked(mesh, own ? plain : null, its, parser);
      return { mesh, plain, ...await make(bake), direct: bake.direct && await make(bake.direct) };
    } catch (error) {
      problems.push(`${document.name ?? mesh.name} is shown with its plain material: ${error.message}`);
      return { mesh, plain };
    }
  }

  // The material that shows a bake.
  async #baked({ geometry }, plain, bake, parser) {
    if (bake.images) {
      geometry.setAttribute('_prt_uv', bake.uv);
      bake.atlas = await this.#atlas(bake, parser);
    }
    const baked = bakedMaterial(plain, bake);
    checkRoom(bake, geometry, baked, this.renderer.capabilities.maxAttributes);
    return { baked, bake };
  }

  // What of a primitive is shown: all its light, or that without bounces where the file has it.
  #chosen(primitive) {
    return this.options.bounces ? primitive : primitive.direct ?? primitive;
  }

  // The decoded pictures of a bake; objects of one atlas share them.
  async #atlas(bake, parser) {
    const { images, scale, offset, layout } = bake;
    const key = JSON.stringify([images, scale, offset, layout]);
    if (!this.atlases.has(key)) {
      const views = images.map((index) => parser.getDependency('bufferView', parser.json.images[index].bufferView));
      this.atlases.set(key, await decoded(this.renderer, bake, await Promise.all(views)));
    }
    return this.atlases.get(key);
  }

  // Another environment, from a .hdr or .exr file.
  loadEnvironment(name, buffer) {
    const picture = environment.read(name, buffer);
    this.#forgetPicture();
    this.picture = picture;
    this.#showEnvironment();
    this.update();
  }

  // The file's own light again.
  resetEnvironment() {
    this.#forgetPicture();
    this.#showEnvironment();
    this.update();
  }

  // Angles in degrees about the vertical axis, counter-clockwise seen from above.
  turn({ environment: e = this.turns.environment, model: m = this.turns.model }) {
    this.turns = { environment: e, model: m };
    this.update();
  }

  set(options) {
    Object.assign(this.options, options);
    this.update();
  }

  show(view) {
    this.view = view;
    this.update();
  }

  // The light as it is turned, before any node's own turn.
  get shownLight() {
    const light = this.picture?.light ?? this.light.radiance;
    return this.turns.environment ? rotate(light, aboutY(radians(this.turns.environment))) : light;
  }

  // Let every uniform follow what was chosen.
  update() {
    const angle = radians(this.turns.environment);
    this.pivot.rotation.y = radians(this.turns.model);
    this.scene.backgroundRotation.y = this.scene.environmentRotation.y = angle;
    this.scene.background = this.options.background ? this.backdrop : null;
    this.scene.updateMatrixWorld(true);
    this.rigid = true;
    for (const primitive of this.primitives) {
      const { mesh, plain } = primitive, chosen = this.#chosen(primitive);
      mesh.material = chosen.baked && this.view !== 'plain' ? chosen.baked : plain;
      if (chosen.baked) this.#light(mesh, chosen);
    }
  }

  #light(mesh, { baked, bake }) {
    const now = new THREE.Matrix3().setFromMatrix4(mesh.matrixWorld).elements;
    const { light, rigid } = lightOfNode(this.shownLight, now, bake.matrix);
    this.rigid &&= rigid;
    const lights = this.options.lights ? this.light.lights.slice(0, bake.lights) : [];
    const found = terms(light, this.light.baked, bake.turns, lights);
    if (!this.options.residual) found.residual = [];
    setLight(baked.userData.prt, bake, found);
    baked.userData.prt.prtAlbedo.value = this.options.albedo ? 1 : 0;
  }

  // Draws one picture.
  render() {
    this.controls.update();
    if (this.view === 'error') this.errorView.render(this.renderer, this.scene, this.camera, (view) => this.#swap(view));
    else this.renderer.render(this.scene, this.camera);
  }

  #swap(view) {
    for (const primitive of this.primitives) {
      const { baked } = this.#chosen(primitive);
      primitive.mesh.material = view === 'baked' && baked ? baked : primitive.plain;
    }
  }

  resize(width, height, ratio = 1) {
    this.renderer.setPixelRatio(ratio);
    this.renderer.setSize(width, height, false);
    this.camera.aspect = width / height;
    this.camera.updateProjectionMatrix();
  }

  // Linear radiance, RGBA float32, bottom row first: what is on the canvas, unrounded.
  readFloat(width, height) {
    const target = new THREE.WebGLRenderTarget(width, height, { type: THREE.FloatType });
    const pixels = new Float32Array(4 * width * height);
    this.renderer.setRenderTarget(target);
    this.render();
    this.renderer.readRenderTargetPixels(target, 0, 0, width, height, pixels);
    this.renderer.setRenderTarget(null);
    target.dispose();
    return pixels;
  }

  // The canvas, RGBA bytes, bottom row first.
  readBytes() {
    const gl = this.renderer.getContext();
    this.render();
    const { drawingBufferWidth: width, drawingBufferHeight: height } = gl;
    const pixels = new Uint8Array(4 * width * height);
    gl.readPixels(0, 0, width, height, gl.RGBA, gl.UNSIGNED_BYTE, pixels);
    return pixels;
  }

  #place(model) {
    const box = new THREE.Box3().setFromObject(model);
    const centre = box.getCenter(new THREE.Vector3());
    const radius = Math.max(box.getSize(new THREE.Vector3()).length() / 2, 1e-6);
    this.pivot.rotation.y = 0;
    this.pivot.position.copy(centre);
    model.position.sub(centre);
    this.pivot.add(model);
    const distance = radius / Math.sin(radians(FOV / 2));
    this.controls.target.copy(centre);
    this.camera.position.set(0.55, 0.4, 1).setLength(0.75 * distance).add(centre);
    this.camera.near = distance / 1000;
    this.camera.far = 20 * distance;
    this.camera.updateProjectionMatrix();
    this.controls.update();
  }

  #showEnvironment() {
    for (const texture of new Set([this.scene.environment, this.backdrop])) texture?.dispose();
    const light = this.light?.radiance ?? GREY;
    this.scene.environment = this.picture?.texture ?? environment.ofLight(light);
    this.backdrop = this.picture?.texture ?? environment.ofLight(environment.softened(light));
  }

  #forgetPicture() {
    if (this.picture) this.turns.environment = 0;
    this.picture = null;
  }

  #clear() {
    for (const { mesh, plain, baked, direct } of this.primitives) {
      mesh.geometry.dispose();
      plain.dispose();
      for (const material of [baked, direct?.baked]) {
        material?.dispose();
        material?.userData.prt.prtClusters?.value.dispose();
      }
    }
    for (const texture of this.atlases.values()) texture.dispose();
    this.atlases.clear();
    this.pivot.clear();
    this.primitives = [];
  }
}

const radians = (degrees) => degrees * Math.PI / 180;
