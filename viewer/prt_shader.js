// The reference shader of docs/gltf.md.
//
//   exit radiance = albedo · max(0, Σ T_i l_i + w R + Σ S_j wlamp_j)
//
// The sum is linear in what the vertices hold, so it is taken in the vertex shader and interpolated:
// one varying, whatever the order. The clamp and the albedo come after that.

const XYZW = 'xyzw';
const FACTORS = { T: 'prtTransfer', R: 'prtResidual', S: 'prtLights' };

// Above main() of the vertex shader. `layout` is that of mesh.extras.prt; names of attributes are in
// lower case because three.js makes them so.
export function declarations(layout) {
  const count = (kind) => 1 + Math.max(0, ...layout.filter((s) => s[0] === kind).map((s) => parseInt(s.slice(1))));
  const attributes = Array.from({ length: layout.length / 4 }, (_, k) => `attribute vec4 _prt_${k};`);
  return `
    ${attributes.join('\n')}
    uniform vec3 prtTransfer[${count('T')}];  // l_i: light, less what the cut-out lights are
    uniform vec3 prtResidual[${count('R')}];  // w of each turn
    uniform vec3 prtLights[${count('S')}];    // w E_j / π
    uniform vec4 prtScale[${layout.length / 4}];      // 1, or that of normalized SHORT
    varying vec3 prtSum;
  `;
}

// In main() of the vertex shader: each stored float times its factor.
export function sum(layout) {
  const lines = layout.flatMap((slot, i) => {
    const name = /^([TRS])(\d+)([rgb]?)$/.exec(slot);
    if (!name) return [];
    const [, kind, index, channel] = name;
    const stored = `prt${i >> 2}.${XYZW[i & 3]}`;
    const component = channel ? `.${channel}` : '';
    return [`prtSum${component} += ${stored} * ${FACTORS[kind]}[${index}]${component};`];
  });
  const scaled = Array.from({ length: layout.length / 4 }, (_, k) => `vec4 prt${k} = prtScale[${k}] * _prt_${k};`);
  return `prtSum = vec3(0.0);\n${scaled.join('\n')}\n${lines.join('\n')}\n`;
}

// In the fragment shader.
export const fragmentDeclarations = `
  uniform float prtAlbedo;   // 1, or 0 for a white surface
  uniform vec3 prtEmission;
  varying vec3 prtSum;
`;
export const exitRadiance =
  'mix(vec3(1.0), diffuseColor.rgb, prtAlbedo) * max(prtSum, vec3(0.0)) + prtEmission';
