// The difference between the bake and the plain material, in false colours.
import * as THREE from 'three';

// Colours from no difference to one of 0.5 of white; style.css has the same for the legend.
const RAMP = /* glsl */`
  vec3 ramp(float x) {
    vec3 colors[5] = vec3[](vec3(0.02, 0.02, 0.05), vec3(0.25, 0.08, 0.45), vec3(0.80, 0.22, 0.35), vec3(0.98, 0.62, 0.25), vec3(1.0, 0.98, 0.85));
    float place = clamp(x, 0.0, 0.9999) * 4.0;
    int before = int(place);
    return mix(colors[before], colors[before + 1], fract(place));
  }
`;

export class ErrorView {
  constructor() {
    const options = { type: THREE.HalfFloatType, samples: 4 };
    this.targets = { baked: new THREE.WebGLRenderTarget(1, 1, options), plain: new THREE.WebGLRenderTarget(1, 1, options) };
    this.material = new THREE.ShaderMaterial({
      uniforms: { baked: { value: null }, plain: { value: null } },
      vertexShader: 'varying vec2 place; void main() { place = uv; gl_Position = vec4(position.xy, 0.0, 1.0); }',
      fragmentShader: `${RAMP}
        uniform sampler2D baked, plain;
        varying vec2 place;
        void main() {
          vec3 difference = abs(texture2D(baked, place).rgb - texture2D(plain, place).rgb);
          gl_FragColor = vec4(ramp(2.0 * dot(difference, vec3(0.2126, 0.7152, 0.0722))), 1.0);
        }`,
      depthTest: false,
    });
    this.quad = new THREE.Mesh(new THREE.PlaneGeometry(2, 2), this.material);
    this.quad.frustumCulled = false;
    this.camera = new THREE.Camera();
  }

  // `swap` gives the scene the materials of a view: 'baked' or 'plain'.
  render(renderer, scene, camera, swap) {
    const size = renderer.getDrawingBufferSize(new THREE.Vector2());
    const background = scene.background, output = renderer.getRenderTarget();
    scene.background = null;
    for (const [view, target] of Object.entries(this.targets)) {
      target.setSize(size.x, size.y);
      swap(view);
      renderer.setRenderTarget(target);
      renderer.render(scene, camera);
      this.material.uniforms[view].value = target.texture;
    }
    swap('baked');
    scene.background = background;
    renderer.setRenderTarget(output);
    renderer.render(this.quad, this.camera);
  }
}
