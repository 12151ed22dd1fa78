// The material of a baked primitive: the artist's, with its diffuse light from the bake.
import * as THREE from 'three';
import { fillTable, inClusters, tableOf } from './clusters.js';
import { exitRadiance, inTexture, onVertices } from './prt_shader.js';

const ALBEDO = 0.8; // of a surface without material, as in Blender
const SHARED = ['map', 'alphaMap', 'opacity', 'transparent', 'alphaTest', 'side', 'vertexColors', 'depthWrite'];

const DECLARATIONS = `
  uniform float prtAlbedo;   // 1, or 0 for a white surface
  uniform vec3 prtEmission;
`;

// `plain` is what GLTFLoader made, or null where the file has no material there. Most surfaces need
// no more than their colour; metals and glowing textures keep three.js' own for the rest.
export function bakedMaterial(plain, bake) {
  const whole = plain?.isMeshStandardMaterial && (plain.metalness > 0 || plain.emissiveMap);
  const material = whole ? plain.clone() : new THREE.MeshBasicMaterial();
  if (!whole && plain) {
    material.color.copy(plain.color);
    for (const name of SHARED) material[name] = plain[name];
  } else if (!whole) material.color.setScalar(ALBEDO);
  const uniforms = uniformsOf(bake);
  const { vertex, fragment } = (bake.atlas ? inTexture : bake.clusters ? inClusters : onVertices)(bake.layout, bake.prefix.toLowerCase());
  if (!whole && plain?.emissive) uniforms.prtEmission.value.copy(plain.emissive).multiplyScalar(plain.emissiveIntensity);
  material.onBeforeCompile = (shader) => {
    Object.assign(shader.uniforms, uniforms);
    shader.vertexShader = `${vertex[0]}\n` + shader.vertexShader.replace(
      '#include <begin_vertex>', `#include <begin_vertex>\n${vertex[1]}`);
    shader.fragmentShader = fragment[0] + DECLARATIONS + (whole ? overMetal : diffuse)(shader.fragmentShader, fragment[1]);
  };
  material.customProgramCacheKey = () => `prt ${whole} ${!!bake.atlas} ${!!bake.clusters} ${bake.prefix} ${bake.layout}`;
  material.userData.prt = uniforms;
  return material;
}

// Nothing but diffuse light.
const diffuse = (text, sum) => replaced(text, 'vec3 outgoingLight = reflectedLight.indirectDiffuse;',
  `${sum}\nvec3 outgoingLight = ${exitRadiance};`);

// The reflections of a dielectric are in no bake; those of metal are three.js'.
const overMetal = (text, sum) => replaced(
  replaced(text, 'vec3 totalSpecular = reflectedLight.directSpecular + reflectedLight.indirectSpecular;',
    'vec3 totalSpecular = metalnessFactor * (reflectedLight.directSpecular + reflectedLight.indirectSpecular);'),
  'vec3 totalDiffuse = reflectedLight.directDiffuse + reflectedLight.indirectDiffuse;',
  `${sum}\nvec3 totalDiffuse = (1.0 - metalnessFactor) * (${exitRadiance});`);

function replaced(text, before, after) {
  if (!text.includes(before)) throw new Error('this version of three.js has other shaders');
  return text.replace(before, after);
}

function uniformsOf({ layout, turns, lights, scale, atlas, clusters }) {
  const vectors = (count) => Array.from({ length: Math.max(1, count) }, () => new THREE.Vector3());
  const transfer = layout.filter((slot) => /^T\d+r?$/.test(slot)).length;
  return {
    prtTransfer: { value: vectors(transfer) },
    prtResidual: { value: vectors(turns) },
    prtLights: { value: vectors(lights) },
    ...(atlas ? { prtAtlas: { value: atlas } } : { prtScale: { value: fours(scale) } }),
    ...(clusters && { prtClusters: { value: tableOf(clusters, layout) } }),
    prtAlbedo: { value: 1 },
    prtEmission: { value: new THREE.Color(0, 0, 0) },
  };
}

const fours = (values) => Array.from({ length: values.length / 4 }, (_, k) => new THREE.Vector4(...values.slice(4 * k, 4 * k + 4)));

// Show the light of `terms` (prt_light.js) on a bake.
export function setLight(uniforms, bake, terms) {
  if (bake.clusters) {
    fillTable(uniforms.prtClusters.value, bake.clusters, terms);
    return;
  }
  const fill = (vectors, triples) => vectors.forEach((v, i) => v.set(...(triples[i] ?? [0, 0, 0])));
  fill(uniforms.prtTransfer.value, terms.transfer);
  fill(uniforms.prtResidual.value, terms.residual);
  fill(uniforms.prtLights.value, terms.lights);
}
