// Reads and checks what docs/gltf.md puts into a glTF file. Errors are sentences for people.

const BASIS = 'real orthonormal, no Condon-Shortley, l(l+1)+m';
const INCLUDES = ['visibility, cosine / pi', 'visibility, cosine / pi, bounces'];

const numbers = (values, count) =>
  Array.isArray(values) && values.length === count && values.every(Number.isFinite);

function check(holds, sentence) {
  if (!holds) throw new Error(sentence);
}

const LARGEST = 32767; // of a normalized SHORT, which stands for 1
const TEXCOORDS = ['uv', 'uv1', 'uv2', 'uv3']; // what three.js calls the first of them

// The bake of one primitive: { layout, turns, lights, matrix, scale, prefix }, and of one in pictures
// { offset, images, uv }, `uv` being the attribute that they are read by, and of one in clusters
// { clusters: { slots, rows } }, `layout` being what the attributes hold, `slots` what a row stands for,
// and `rows` the mean and the directions of each, one after the other. Names of attributes begin with
// `prefix`; `direct` is the same without bounces, where the file has that. `prt` is mesh.extras.prt,
// `geometry` three.js' BufferGeometry, which has the names of attributes in lower case, and `images`
// those of the document.
export function readBake(prt, geometry, images = []) {
  const whole = readStored(prt, geometry, images, '_PRT_');
  return prt.direct ? { ...whole, direct: readDirect(prt, whole, geometry, images) } : whole;
}

function readDirect({ layout, scale, offset, texture, clusters, direct, ...common }, whole, geometry, images) {
  check(common.includes === INCLUDES[1], 'it has direct light apart, and no bounces');
  const prt = { ...common, channels: 1, includes: INCLUDES[0], ...direct };
  const bake = readStored(prt, geometry, images, '_PRT_DIRECT_');
  check(bake.turns === whole.turns && bake.lights === whole.lights, 'direct has another layout than without bounces');
  check(bake.uv === whole.uv, 'direct does not lie where the whole does');
  return bake;
}

function readStored(prt, geometry, images, prefix) {
  check(prt.version === 1, `its bake has version ${prt.version}, and this viewer knows 1`);
  check(Number.isInteger(prt.order) && prt.order >= 1 && prt.order <= 5, `order ${prt.order} is none of 1 to 5`);
  check(prt.channels === 1 || prt.channels === 3, `${prt.channels} channels are neither 1 nor 3`);
  check(prt.frame === 'world', `frame "${prt.frame}" is not "world"`);
  check(prt.basis === BASIS, `basis "${prt.basis}" is not the one of version 1`);
  check(INCLUDES.includes(prt.includes), `"${prt.includes}" is not what a transfer of version 1 includes`);
  check(numbers(prt.matrix, 9), 'matrix is not nine numbers');
  check(prt.matrix.some((value) => value !== 0), 'matrix is all zeros');
  const { layout } = prt, turns = prt.turns ?? (layout?.includes?.('R0r') ? 1 : 0);
  checkLayout(prt, turns);
  const scale = prt.scale === 1 ? layout.map(() => 1) : prt.scale;
  check(numbers(scale, layout.length), `scale is neither 1 nor ${layout.length} numbers`);
  const lights = layout.filter((slot) => slot[0] === 'S').length;
  const bake = { order: prt.order, layout, turns, lights, matrix: prt.matrix, scale, prefix };
  if (prt.texture) return { ...bake, offset: prt.offset, ...readTexture(prt, geometry, images) };
  if (prt.clusters) return { ...bake, ...readClusters(prt, geometry, prefix) };
  checkAttributes(layout, geometry, prefix);
  return bake;
}

function checkLayout({ layout, order, channels, texture, clusters }, turns) {
  const [width, words] = clusters ? [1, 'names'] : texture ? [3, 'three names a picture'] : [4, 'four names an attribute'];
  check(Array.isArray(layout) && layout.length && layout.length % width === 0, `layout is not ${words}`);
  const suffixes = channels === 3 ? ['r', 'g', 'b'] : [''];
  const expected = [...Array(order * order).keys()].flatMap((i) => suffixes.map((c) => `T${i}${c}`));
  for (let k = 0; k < turns; ++k) expected.push(...['r', 'g', 'b'].map((c) => `R${k}${c}`));
  for (const slot of expected) check(layout.includes(slot), `layout has no ${slot}`);
  const used = layout.filter(Boolean);
  const unknown = used.find((slot) => !expected.includes(slot) && !/^(S[0-3]|V(1?[0-9]|2[0-4]))$/.test(slot));
  check(unknown === undefined, `layout has ${unknown}, which order, channels and turns leave no place for`);
  check(new Set(used).size === used.length, 'layout has a name twice');
}

function readClusters({ layout: slots, clusters: { layout, values } }, geometry, prefix) {
  const weights = Array.isArray(layout) ? layout.filter((name) => /^W\d+$/.test(name)).length : 0;
  const expected = ['K', ...Array.from({ length: weights }, (_, j) => `W${j}`)];
  check(weights && layout.length % 4 === 0 && layout.filter(Boolean).length === expected.length
    && expected.every((name) => layout.includes(name)), "the clusters' layout is not K, W0, W1, …");
  checkAttributes(layout, geometry, prefix);
  const width = (1 + weights) * slots.length, count = values?.length / width;
  check(Number.isInteger(count) && count > 0 && numbers(values, values.length), `the clusters' values are not ${width} numbers each`);
  const place = layout.indexOf('K'), attribute = geometry.attributes[`${prefix}${place >> 2}`.toLowerCase()];
  for (let i = 0; i < attribute.count; ++i) {
    const number = Math.round(attribute.getComponent(i, place & 3) * LARGEST);
    check(number >= 0 && number < count, `a vertex is of cluster ${number}, and there are ${count}`);
  }
  const rows = Array.from({ length: count * (1 + weights) }, (_, k) => values.slice(k * slots.length, (k + 1) * slots.length));
  return { layout, scale: layout.map((name) => (name === 'K' ? LARGEST : 1)), clusters: { slots, rows } };
}

function readTexture({ texture, layout, offset }, geometry, images) {
  check(numbers(offset, layout.length), `offset is not ${layout.length} numbers`);
  const count = layout.length / 3;
  check(Array.isArray(texture.images) && texture.images.length === count, `texture has not ${count} images`);
  for (const index of texture.images) check(images[index]?.bufferView !== undefined, `image ${index} is not in the file`);
  const name = TEXCOORDS[texture.texCoord] ?? `texcoord_${texture.texCoord}`;
  const uv = geometry.attributes[name];
  check(uv, `attribute TEXCOORD_${texture.texCoord} is missing`);
  check(uv.array.every(Number.isFinite), `attribute TEXCOORD_${texture.texCoord} has a value that is no number`);
  return { images: texture.images, uv };
}

function checkAttributes(layout, geometry, prefix) {
  const { position } = geometry.attributes;
  for (let k = 0; k < layout.length / 4; ++k) {
    const name = `${prefix}${k}`, attribute = geometry.attributes[name.toLowerCase()];
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
export function checkRoom({ layout, images }, geometry, material, most) {
  const textures = Object.values(material).filter((value) => value?.isTexture);
  const names = ['position', ...new Set(textures.map(({ channel }) => `uv${channel || ''}`))];
  if (material.vertexColors) names.push('color');
  if (material.isMeshStandardMaterial) names.push('normal', 'tangent');
  const own = names.filter((name) => geometry.attributes[name]).length;
  const used = own + (images ? 1 : layout.length / 4);
  check(used <= most, `it takes ${used} vertex attributes, and WebGL has ${most} here`);
}
