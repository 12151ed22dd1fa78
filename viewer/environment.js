// Environments: lat-long pictures from .hdr and .exr files, or the coarse one that a light's
// coefficients are.
import * as THREE from 'three';
import { EXRLoader } from 'three/addons/loaders/EXRLoader.js';
import { HDRLoader } from 'three/addons/loaders/HDRLoader.js';
import { ORDER, basis, orderOf, project } from './sh.js';

const WIDEST = 4096; // of what is shown; what is measured is the whole picture
const RGBE = 255 / 256; // a mantissa counts 256ths (Ward), and three.js takes 255ths

// { light, texture } of a file.
export function read(name, buffer) {
  const loader = /\.exr$/i.test(name) ? new EXRLoader() : /\.hdr$/i.test(name) ? new HDRLoader() : null;
  if (!loader) throw new Error(`${name} is neither .glb, .hdr nor .exr`);
  loader.setDataType(THREE.FloatType);
  let picture;
  try {
    picture = loader.parse(buffer);
  } catch (error) {
    throw new Error(`${name} cannot be read: ${error.message ?? error}`);
  }
  const { data, width, height } = picture;
  if (width !== 2 * height) throw new Error(`${name} is ${width} by ${height}, and a lat-long picture is twice as wide as high`);
  const channels = data.length / (width * height);
  const exr = loader instanceof EXRLoader;
  const pixels = repaired(data, exr ? 1 : RGBE);
  const upright = exr ? flipped(pixels, width, height, channels) : pixels;
  return { light: project(upright, width, height, channels), texture: textureOf(upright, width, height, channels) };
}

// Negative pixels and NaN are 0, infinite ones the largest finite one; all times `factor`.
function repaired(data, factor) {
  let largest = 0;
  for (const value of data) if (value > largest && value < Infinity) largest = value;
  return data.map((value) => (value > 0 ? factor * Math.min(value, largest) : 0));
}

// three.js reads EXR from the bottom row up.
function flipped(pixels, width, height, channels) {
  const result = new Float32Array(pixels.length), row = width * channels;
  for (let y = 0; y < height; ++y) result.set(pixels.subarray(y * row, (y + 1) * row), (height - 1 - y) * row);
  return result;
}

// Light without the ringing of its harmonics, to be looked at and not to be lit by.
export const softened = (light) => light.map((triple, i) => {
  const fading = (1 + Math.cos(Math.PI * Math.floor(Math.sqrt(i)) / ORDER)) / 2;
  return triple.map((value) => fading * value);
});

// A picture of a light's coefficients, clamped at 0: what is known where no picture is.
export function ofLight(light) {
  const width = 128, height = 64, pixels = new Float32Array(3 * width * height), order = Math.min(ORDER, orderOf(light));
  for (let y = 0; y < height; ++y) {
    for (let x = 0; x < width; ++x) {
      const phi = 2 * Math.PI * ((x + 0.5) / width - 0.5), up = Math.PI * (0.5 - (y + 0.5) / height);
      const values = basis(Math.cos(up) * Math.cos(phi), Math.sin(up), Math.cos(up) * Math.sin(phi), order);
      for (let c = 0; c < 3; ++c) {
        pixels[3 * (y * width + x) + c] = Math.max(0, values.reduce((sum, v, i) => sum + v * light[i][c], 0));
      }
    }
  }
  return textureOf(pixels, width, height, 3);
}

function textureOf(pixels, width, height, channels) {
  const step = Math.ceil(width / WIDEST), w = Math.floor(width / step), h = Math.floor(height / step);
  const half = new Uint16Array(4 * w * h), one = THREE.DataUtils.toHalfFloat(1);
  for (let y = 0; y < h; ++y) {
    for (let x = 0; x < w; ++x) {
      const at = (y * step * width + x * step) * channels, to = 4 * ((h - 1 - y) * w + x);
      for (let c = 0; c < 3; ++c) half[to + c] = THREE.DataUtils.toHalfFloat(Math.min(65504, pixels[at + (channels < 3 ? 0 : c)]));
      half[to + 3] = one;
    }
  }
  const texture = new THREE.DataTexture(half, w, h, THREE.RGBAFormat, THREE.HalfFloatType);
  texture.mapping = THREE.EquirectangularReflectionMapping;
  texture.colorSpace = THREE.LinearSRGBColorSpace;
  texture.magFilter = texture.minFilter = THREE.LinearFilter;
  texture.wrapS = THREE.RepeatWrapping;
  texture.needsUpdate = true;
  return texture;
}
