// A bake in clusters of principal components, as docs/gltf.md has it. Of the mean and the directions of
// each cluster, what they make under the light stands in a row of a table, worked out once a light: a
// vertex adds up its own with its weights.
import * as THREE from 'three';
import { XYZW, onVertices, quarters } from './prt_shader.js';

// As prt_shader.js' onVertices.
export function inClusters(layout, name) {
  const stored = (slot) => `prt${layout.indexOf(slot) >> 2}.${XYZW[layout.indexOf(slot) & 3]}`;
  const weights = layout.filter((slot) => slot[0] === 'W').map((slot) =>
    `prtSum += ${stored(slot)} * texelFetch(prtClusters, ivec2(${1 + parseInt(slot.slice(1))}, prtCluster), 0).rgb;`);
  const { vertex: [declarations], fragment } = onVertices(layout, name);
  return {
    vertex: [`${declarations} uniform highp sampler2D prtClusters;`, [
      ...quarters(layout).map((k) => `vec4 prt${k} = prtScale[${k}] * ${name}${k};`),
      `int prtCluster = int(${stored('K')} + 0.5);`,
      'prtSum = texelFetch(prtClusters, ivec2(0, prtCluster), 0).rgb;', ...weights].join('\n')],
    fragment,
  };
}

// A texel for the mean and each direction of a cluster, a row for each cluster.
export function tableOf({ rows }, layout) {
  const width = layout.filter((name) => name[0] === 'W').length + 1;
  const table = new THREE.DataTexture(new Float32Array(4 * rows.length), width, rows.length / width, THREE.RGBAFormat, THREE.FloatType);
  table.needsUpdate = true;
  return table;
}

// What each row of floats makes under the light of `terms`.
export function fillTable(table, { slots, rows }, terms) {
  const factors = slots.map((slot) => {
    const [, kind, index, channel] = /^([TRSV])(\d+)([rgb]?)$/.exec(slot);
    const triple = { T: terms.transfer, R: terms.residual, S: terms.lights, V: [] }[kind][index] ?? [0, 0, 0];
    return triple.map((value, c) => (channel && channel !== 'rgb'[c] ? 0 : value));
  });
  rows.forEach((row, k) => {
    for (let c = 0; c < 3; ++c) table.image.data[4 * k + c] = row.reduce((sum, value, i) => sum + value * factors[i][c], 0);
  });
  table.needsUpdate = true;
}
