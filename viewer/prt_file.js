// Reads and checks what docs/gltf.md puts into a glTF file. Errors are sentences for people.

const BASIS = 'real orthonormal, no Condon-Shortley, l(l+1)+m';
const INCLUDES = ['visibility, cosine / pi', 'visibility, cosine / pi, bounces'];

const numbers = (values, count) =>
  Array.isArray(values) && values.length === count && values.every(Number.isFinite);

function check(holds, sentence) {
  if (!holds) throw new Error(sentence);
}

// The bake of one primitive: { layout, turns, lights, matrix, scale }. `prt` is mesh.extras.prt,
// `geometry` three.js' BufferGeometry, which has the names of attributes in lower case.
export function readBake(prt, geometry) {
  check(prt.version === 1, `its bake has version ${prt.version}, and this viewer knows 1`);
  check(Number.isInteger(prt.order) && prt.order >= 1 && prt.order <= 5, `order ${prt.order} is none of 1 to 5`);
  check(prt.channels === 1 || prt.channels === 3, `${prt.channels} channels are neither 1 nor 3`);
  check(prt.frame === 'world', `frame "${prt.frame}" is not "world"`);
  check(prt.basis === BASIS, `basis "${prt.basis}" is not the one of version 1`);
  check(INCLUDES.includes(prt.includes), `"${prt.includes}" is not what a transfer of version 1 includes`);
  check(numbers(prt.matrix, 9), 'matrix is not nine numbers');
  const turns = prt.turns ?? (prt.layout?.includes?.('R0r') ? 1 : 0);
  checkLayout(prt, turns);
  const { layout } = prt;
  const scale = prt.scale === 1 ? layout.map(() => 1) : prt.scale;
  check(numbers(scale, layout.length), `scale is neither 1 nor ${layout.length} numbers`);
  checkAttributes(layout, geometry);
  const lights = layout.filter((slot) => slot[0] === 'S').length;
  return { order: prt.order, layout, turns, lights, matrix: prt.matrix, scale };
}

function checkLayout({ layout, order, channels }, turns) {
  check(Array.isArray(layout) && layout.length && layout.length % 4 === 0, 'layout is not four names an attribute');
  const suffixes = channels === 3 ? ['r', 'g', 'b'] : [''];
  const expected = [...Array(order * order).keys()].flatMap((i) => suffixes.map((c) => `T${i}${c}`));
  for (let k = 0; k < turns; ++k) expected.push(...['r', 'g', 'b'].map((c) => `R${k}${c}`));
  for (const slot of expected) check(layout.includes(slot), `layout has no ${slot}`);
  const used = layout.filter(Boolean);
  const unknown = used.find((slot) => !expected.includes(slot) && !/^(S[0-3]|V(1?[0-9]|2[0-4]))$/.test(slot));
  check(unknown === undefined, `layout has ${unknown}, which order, channels and turns leave no place for`);
  check(new Set(used).size === used.length, 'layout has a name twice');
}

function checkAttributes(layout, geometry) {
  const { position } = geometry.attributes;
  for (let k = 0; k < layout.length / 4; ++k) {
    const name = `_PRT_${k}`, attribute = geometry.attributes[name.toLowerCase()];
    check(attribute, `attribute ${name} is missing`);
    check(attribute.itemSize === 4, `attribute ${name} is no VEC4`);
    check(attribute.count === position.count,
      `attribute ${name} has ${attribute.count} values for ${position.count} vertices`);
    check(attribute.array.every(Number.isFinite), `attribute ${name} has a value that is no number`);
  }
}

// scene.extras.prt_light as { radiance, baked, lights }.
export function readLight(light) {
  check(light, 'the scene has no prt_light in its extras');
  const count = light.order ** 2;
  check(Number.isInteger(light.order) && light.order >= 1 && light.order <= 5, `the light's order ${light.order} is none of 1 to 5`);
  for (const name of ['radiance_sh', 'baked_radiance_sh']) {
    const triples = light[name];
    check(Array.isArray(triples) && triples.length === count && triples.every((t) => numbers(t, 3)),
      `the light's ${name} is not ${count} triples of numbers`);
  }
  const lights = light.lights ?? [];
  const whole = (one) => numbers(one.direction, 3) && Math.hypot(...one.direction) > 0
    && numbers(one.irradiance, 3) && Number.isFinite(one.angular_radius);
  check(Array.isArray(lights) && lights.length <= 4 && lights.every(whole), 'a cut-out light of the scene is not whole');
  return { radiance: light.radiance_sh, baked: light.baked_radiance_sh, lights };
}

// WebGL has 16 vertex attributes. Of the material's own, position, texture coordinates and vertex
// colours remain; what Blender's EEVEE shows (14 with the artist's own) always fits.
export function checkRoom(layout, geometry, material, most) {
  const textures = Object.values(material).filter((value) => value?.isTexture);
  const names = ['position', ...new Set(textures.map(({ channel }) => `uv${channel || ''}`))];
  if (material.vertexColors) names.push('color');
  if (material.isMeshStandardMaterial) names.push('normal', 'tangent');
  const own = names.filter((name) => geometry.attributes[name]).length;
  const used = own + layout.length / 4;
  check(used <= most, `it takes ${used} vertex attributes, and WebGL has ${most} here`);
}
