// A bake in pictures, as docs/gltf.md has it: numbers of 16 bits, the high bytes above the low ones.
// They are decoded once into a texture of floats: filters and mips are to mix numbers. Mixed as bytes
// they would be right as long as nothing is rounded, and graphics cards round to 8 bits.
import * as THREE from 'three';

const KEPT = { colorSpaceConversion: 'none', premultiplyAlpha: 'none' };
const LAYER = new THREE.ShaderMaterial({
  glslVersion: THREE.GLSL3,
  depthTest: false,
  depthWrite: false,
  uniforms: {
    first: { value: null }, second: { value: null }, size: { value: 0 },
    which: { value: new THREE.Vector4() }, scale: { value: new THREE.Vector4() }, offset: { value: new THREE.Vector4() },
  },
  vertexShader: 'void main() { gl_Position = vec4(position.xy, 0.0, 1.0); }',
  fragmentShader: `
    uniform highp sampler2D first, second;  // three numbers a texel each
    uniform int size;
    uniform vec4 which, scale, offset;      // number 0 to 5 of both
    layout(location = 0) out highp vec4 values;
    highp float number(ivec2 at, int i) {
      highp vec4 bytes = i < 3 ? texelFetch(first, at, 0) : texelFetch(second, at, 0);
      return bytes[i % 3];
    }
    void main() {
      ivec2 at = ivec2(gl_FragCoord.xy);
      highp vec4 shares;
      for (int c = 0; c < 4; ++c) {
        int i = int(which[c]);
        shares[c] = (256.0 * number(at, i) + number(at + ivec2(0, size), i)) / 257.0;
      }
      values = offset + scale * shares;
    }`,
});
const QUAD = new THREE.Mesh(new THREE.PlaneGeometry(2, 2), LAYER);
QUAD.frustumCulled = false;

// The texture of a bake { layout, scale, offset } whose pictures are the PNG files `buffers`: layer k
// holds floats 4 k … 4 k + 3, as they are meant. dispose() it.
export async function decoded(renderer, { layout, scale, offset }, buffers) {
  const pictures = await Promise.all(buffers.map(pictureOf));
  try {
    const size = pictures[0].image.width;
    for (const { image } of pictures) {
      if (image.width !== size || image.height !== 2 * size) {
        throw new Error(`a picture of the bake is ${image.width} by ${image.height}, and not ${size} by ${2 * size}`);
      }
    }
    return draw(renderer, size, { layout, scale, offset }, pictures);
  } finally {
    for (const texture of pictures) {
      texture.image.close();
      texture.dispose();
    }
  }
}

async function pictureOf(buffer) {
  let image;
  try {
    image = await createImageBitmap(new Blob([buffer], { type: 'image/png' }), KEPT);
  } catch (error) {
    throw new Error(`a picture of the bake cannot be decoded: ${error.message}`);
  }
  const texture = new THREE.Texture(image);
  texture.colorSpace = THREE.NoColorSpace;
  texture.minFilter = texture.magFilter = THREE.NearestFilter;
  texture.generateMipmaps = texture.flipY = texture.premultiplyAlpha = false;
  texture.needsUpdate = true;
  return texture;
}

// Half floats, where floats cannot be filtered, are off by up to 1/1024 of each number.
function draw(renderer, size, { layout, scale, offset }, pictures) {
  const layers = Math.ceil(layout.length / 4), whole = renderer.extensions.has('OES_texture_float_linear');
  const target = new THREE.WebGLArrayRenderTarget(size, size, layers, {
    type: whole ? THREE.FloatType : THREE.HalfFloatType, depthBuffer: false,
    minFilter: THREE.LinearMipmapLinearFilter, magFilter: THREE.LinearFilter, generateMipmaps: true,
  });
  const output = renderer.getRenderTarget(), camera = new THREE.Camera(), { uniforms } = LAYER;
  for (let k = 0; k < layers; ++k) {
    const from = Math.floor(4 * k / 3), four = [0, 1, 2, 3].map((c) => 4 * k + c);
    uniforms.first.value = pictures[from];
    uniforms.second.value = pictures[from + 1] ?? pictures[from];
    uniforms.size.value = size;
    uniforms.which.value.set(...four.map((i) => i - 3 * from));
    uniforms.scale.value.set(...four.map((i) => scale[i] ?? 0));
    uniforms.offset.value.set(...four.map((i) => offset[i] ?? 0));
    renderer.setRenderTarget(target, k);
    renderer.render(QUAD, camera);
  }
  renderer.setRenderTarget(output);
  target.texture.renderTarget = target;
  target.texture.addEventListener('dispose', () => target.dispose());
  return target.texture;
}
