// What a bake is multiplied by, worked out once a light: docs/gltf.md, "What a reader computes".
import { aboutY, apply, basis, orderOf, rotate } from './sh.js';

const SHARPNESS = 16; // how fast a residual fades as the light turns
const NOTHING = 1e-6; // of a light's norm: what is less has no direction
const DIRECTED = [1, 2, 3, 4, 5, 6, 7, 8]; // l = 1 … 2

const sum = (values) => values.reduce((a, b) => a + b, 0);
const dot = (a, b, places) => sum(places.map((i) => sum([0, 1, 2].map((c) => (a[i]?.[c] ?? 0) * (b[i]?.[c] ?? 0)))));
const norm = (light) => Math.sqrt(dot(light, light, [...light.keys()]));

// Under light `now` (n² triples, in the frame of the bake), with `baked` the light of the bake:
// `transfer` (n² triples), `residual` (a triple a turn) and `lights` (a triple a cut-out light) are
// the factors of T, R and S.
export function terms(now, baked, turns, lights) {
  const residual = turnWeights(now, baked, Math.max(1, turns));
  const w = residual[0]; // the cut-out lights stand where they stood when baked
  const cutOut = lightsSh(lights, now.length);
  return {
    transfer: now.map((l, i) => l.map((value, c) => value - w[c] * cutOut[i][c])),
    residual: residual.slice(0, turns),
    lights: lights.map(({ irradiance }) => irradiance.map((e, c) => w[c] * e / Math.PI)),
  };
}

// How much of a residual is shown, a channel.
export function weight(now, baked) {
  const fading = Math.max(0, cosine(now, baked)) ** SHARPNESS;
  return [0, 1, 2].map((c) => {
    const [a, b] = [now, baked].map((light) => Math.sqrt(sum(light.map((l) => l[c] * l[c]))));
    return b > 0 ? a / b * fading : 0;
  });
}

function cosine(now, baked) {
  const lengths = [now, baked].map((light) => Math.sqrt(dot(light, light, DIRECTED)));
  const faint = [lengths[0] <= NOTHING * norm(now), lengths[1] <= NOTHING * norm(baked)];
  if (faint[0] || faint[1]) return faint[0] && faint[1] ? 1 : 0;
  return dot(now, baked, DIRECTED) / (lengths[0] * lengths[1]);
}

function turnWeights(now, baked, turns) {
  if (turns < 2) return [weight(now, baked)];
  const angle = turnAngle(now, baked);
  const place = angle / (2 * Math.PI) * turns;
  const before = Math.floor(place) % turns, share = place - Math.floor(place);
  const whole = weight(now, rotate(baked, aboutY(angle)));
  const weights = Array.from({ length: turns }, () => [0, 0, 0]);
  weights[before] = whole.map((w) => (1 - share) * w);
  weights[(before + 1) % turns] = whole.map((w) => share * w);
  return weights;
}

// The angle about Y, 0 up to 2π, by which `baked` has to be turned to come nearest to `now` over
// l = 1 … 2. Their product is c0 + c1 cos + s1 sin + c2 cos 2 + s2 sin 2 of the angle: five samples
// give the factors, a scan and Newton's method the largest.
export function turnAngle(now, baked) {
  const samples = [0, 1, 2, 3, 4].map((k) => dot(now, rotate(baked, aboutY(2 * Math.PI * k / 5)), DIRECTED));
  const wave = (f, m) => 2 / 5 * sum(samples.map((s, k) => s * f(2 * Math.PI * m * k / 5)));
  const [c1, s1, c2, s2] = [wave(Math.cos, 1), wave(Math.sin, 1), wave(Math.cos, 2), wave(Math.sin, 2)];
  if (Math.hypot(c1, s1) + Math.hypot(c2, s2) <= NOTHING * norm(now) * norm(baked)) return 0;
  const product = (a) => c1 * Math.cos(a) + s1 * Math.sin(a) + c2 * Math.cos(2 * a) + s2 * Math.sin(2 * a);
  let best = 0;
  for (let k = 1; k < 64; ++k) if (product(Math.PI * k / 32) > product(best)) best = Math.PI * k / 32;
  for (let step = 0; step < 8; ++step) {
    const slope = -c1 * Math.sin(best) + s1 * Math.cos(best) - 2 * c2 * Math.sin(2 * best) + 2 * s2 * Math.cos(2 * best);
    const bend = -c1 * Math.cos(best) - s1 * Math.sin(best) - 4 * c2 * Math.cos(2 * best) - 4 * s2 * Math.sin(2 * best);
    if (bend < 0) best -= Math.max(-0.05, Math.min(0.05, slope / bend));
  }
  return (best + 2 * Math.PI) % (2 * Math.PI);
}

// Coefficients of all cut-out lights, each a disc of constant radiance.
export function lightsSh(lights, count) {
  const total = Array.from({ length: count }, () => [0, 0, 0]);
  const order = orderOf(total);
  for (const { direction, irradiance, angular_radius: radius } of lights) {
    const x = Math.cos(radius);
    const zonal = [2 / (1 + x), 1, x, (5 * x * x - 1) / 4, (7 * x * x * x - 3 * x) / 4];
    basis(...unit(direction), order).forEach((value, i) => {
      irradiance.forEach((e, c) => { total[i][c] += value * zonal[Math.floor(Math.sqrt(i))] * e; });
    });
  }
  return total;
}

const unit = (v) => v.map((x) => x / Math.hypot(...v));

// The light as a node sees it whose world 3x3 (column-major) was `baked` and is `now`: turned by the
// inverse of now · baked⁻¹. `rigid` tells whether that is a rotation.
export function lightOfNode(light, now, baked) {
  const turn = multiply(now, inverse(baked));
  const back = transpose(turn);
  const square = multiply(turn, back);
  const rigid = square.every((v, i) => Math.abs(v - (i % 4 ? 0 : 1)) < 1e-3);
  const still = turn.every((v, i) => Math.abs(v - (i % 4 ? 0 : 1)) < 1e-6);
  return { light: rigid && !still ? rotate(light, back) : light, rigid };
}

const transpose = (m) => [0, 3, 6, 1, 4, 7, 2, 5, 8].map((i) => m[i]);
const multiply = (a, b) => [0, 3, 6].flatMap((k) => apply(a, b.slice(k, k + 3)));
const cross = (a, b) => [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];

function inverse(m) {
  const [a, b, c] = [m.slice(0, 3), m.slice(3, 6), m.slice(6, 9)];
  const rows = [cross(b, c), cross(c, a), cross(a, b)];
  const determinant = sum(a.map((v, i) => v * rows[0][i]));
  return transpose(rows.flat().map((v) => v / determinant));
}
