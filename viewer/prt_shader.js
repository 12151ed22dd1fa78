// The reference shader of docs/gltf.md.
//
//   exit radiance = albedo · max(0, Σ T_i l_i + w R + Σ S_j wlamp_j)
//
// The sum is linear in what is stored. Where that is at the vertices it is taken in the vertex shader
// and interpolated: one varying, whatever the order. The clamp and the albedo come after that.

export const XYZW = 'xyzw';
const FACTORS = { T: 'prtTransfer', R: 'prtResidual', S: 'prtLights' };

// What a bake of `layout` (of mesh.extras.prt) is multiplied by.
function factors(layout) {
  const count = (kind) => 1 + Math.max(0, ...layout.filter((s) => s[0] === kind).map((s) => parseInt(s.slice(1))));
  return `
    uniform vec3 prtTransfer[${count('T')}];  // l_i: light, less what the cut-out lights are
    uniform vec3 prtResidual[${count('R')}];  // w of each turn
    uniform vec3 prtLights[${count('S')}];    // w E_j / π
  `;
}

// The stored floats, four to each of `vectors`, times their factors.
function sum(layout, vectors) {
  const lines = layout.flatMap((slot, i) => {
    const name = /^([TRS])(\d+)([rgb]?)$/.exec(slot);
    if (!name) return [];
    const [, kind, index, channel] = name;
    const component = channel ? `.${channel}` : '';
    return [`prtSum${component} += prt${i >> 2}.${XYZW[i & 3]} * ${FACTORS[kind]}[${index}]${component};`];
  });
  return [...vectors.map((vector, k) => `vec4 prt${k} = ${vector};`), 'prtSum = vec3(0.0);', ...lines].join('\n');
}

export const quarters = (layout) => [...Array(Math.ceil(layout.length / 4)).keys()];

// A bake in attributes `name`0, `name`1, …; three.js makes their names lower case. `vertex` and
// `fragment` are what stands above main() and in it.
export const onVertices = (layout, name) => ({
  vertex: [`${quarters(layout).map((k) => `attribute vec4 ${name}${k};`).join('\n')} ${factors(layout)}
    uniform vec4 prtScale[${layout.length / 4}]; // 1, or that of normalized SHORT
    varying vec3 prtSum;`, sum(layout, quarters(layout).map((k) => `prtScale[${k}] * ${name}${k}`))],
  fragment: ['varying vec3 prtSum;', ''],
});

// A bake in the layers of a texture, decoded: atlas.js.
export const inTexture = (layout) => ({
  vertex: ['attribute vec2 _prt_uv; varying vec2 prtUv;', 'prtUv = _prt_uv;'],
  fragment: [`uniform highp sampler2DArray prtAtlas; varying vec2 prtUv; ${factors(layout)}`,
    `vec3 prtSum; ${sum(layout, quarters(layout).map((k) => `texture(prtAtlas, vec3(prtUv, ${k}.0))`))}`],
});

export const exitRadiance = 'mix(vec3(1.0), diffuseColor.rgb, prtAlbedo) * max(prtSum, vec3(0.0)) + prtEmission';
