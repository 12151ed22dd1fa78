// Real spherical harmonics: orthonormal, no Condon-Shortley phase, (l, m) at l (l + 1) + m, as in
// docs/gltf.md. Light is an array of n² triples [r, g, b], its directions are glTF's, Y up.

export const ORDER = 5; // of every light here

export const orderOf = (coefficients) => Math.round(Math.sqrt(coefficients.length));

// Values of the first `order` bands in the direction of the unit vector (x, y, z): the recurrence
// of the normalised associated Legendre functions, Numerical Recipes, 3rd ed., 6.7.
export function basis(x, y, z, order = ORDER) {
  const values = new Array(order * order);
  let cosine = 1, sine = 0, sectoral = Math.sqrt(0.25 / Math.PI);
  for (let m = 0; m < order; ++m) {
    if (m) {
      sectoral *= Math.sqrt((2 * m + 1) / (2 * m));
      [cosine, sine] = [x * cosine - y * sine, x * sine + y * cosine];
    }
    legendre(z, m, order, sectoral, (l, value) => {
      if (m === 0) values[l * (l + 1)] = value;
      else {
        values[l * (l + 1) + m] = Math.SQRT2 * value * cosine;
        values[l * (l + 1) - m] = Math.SQRT2 * value * sine;
      }
    });
  }
  return values;
}

// Calls visit(l, value) for l = m … order - 1: the associated Legendre functions over sin^m.
function legendre(z, m, order, sectoral, visit) {
  let before = 0, value = sectoral;
  for (let l = m; l < order; ++l) {
    if (l > m) {
      const a = Math.sqrt((4 * l * l - 1) / (l * l - m * m));
      const b = Math.sqrt(((l - 1) ** 2 - m * m) / (4 * (l - 1) ** 2 - 1));
      [before, value] = [value, a * (z * value - b * before)];
    }
    visit(l, value);
  }
}

// Gauss-Legendre nodes and weights on -1 … 1, by Newton's method.
export function gauss(count) {
  return Array.from({ length: count }, (_, i) => {
    let x = Math.cos(Math.PI * (i + 0.75) / (count + 0.5)), slope = 1;
    for (let step = 0; step < 20; ++step) {
      let before = 0, value = 1;
      for (let l = 1; l <= count; ++l) {
        [before, value] = [value, ((2 * l - 1) * x * value - (l - 1) * before) / l];
      }
      slope = count * (x * value - before) / (x * x - 1);
      x -= value / slope;
    }
    return { x, weight: 2 / ((1 - x * x) * slope * slope) };
  });
}

// Directions and weights that integrate products of two functions of ORDER exactly.
const quadrature = gauss(ORDER).flatMap(({ x: z, weight }) =>
  Array.from({ length: 2 * ORDER }, (_, i) => {
    const phi = Math.PI * i / ORDER, r = Math.sqrt(1 - z * z);
    const direction = [r * Math.cos(phi), r * Math.sin(phi), z];
    return { direction, weighted: basis(...direction).map((v) => v * weight * Math.PI / ORDER) };
  }));

export const apply = (m, [x, y, z]) => [0, 1, 2].map((i) => m[i] * x + m[i + 3] * y + m[i + 6] * z);

// Light turned with a rotation (9 numbers, column-major): its value at R ω is the old one at ω.
export function rotate(light, rotation) {
  const turned = light.map(() => [0, 0, 0]), order = orderOf(light);
  for (const { direction, weighted } of quadrature) {
    const radiance = [0, 1, 2].map((c) => light.reduce((sum, l, i) => sum + l[c] * weighted[i], 0));
    // Band by band: a product of different bands is integrated too, and is zero
    basis(...apply(rotation, direction), order).forEach((value, i) => {
      for (let c = 0; c < 3; ++c) turned[i][c] += value * radiance[c];
    });
  }
  return turned;
}

// The rotation about Y, counter-clockwise seen from above.
export function aboutY(angle) {
  const c = Math.cos(angle), s = Math.sin(angle);
  return [c, 0, -s, 0, 1, 0, s, 0, c];
}

// Light of a lat-long picture: `pixels` of `channels` floats each, top row first. Each texel is a
// patch of constant radiance, over which the basis is integrated: exactly in azimuth, by Gauss of
// degree 7 in elevation. u = 0.5 + atan2(z, x) / 2π, v = 0.5 + asin(y) / π.
export function project(pixels, width, height, channels) {
  const light = Array.from({ length: ORDER * ORDER }, () => [0, 0, 0]);
  const step = 2 * Math.PI / width, nodes = gauss(4);
  const waves = waveTables(width);
  const row = new Float64Array(3 * (2 * ORDER - 1)); // Σ L cos mφ, then Σ L sin mφ
  for (let y = 0; y < height; ++y) {
    row.fill(0);
    for (let x = 0, at = y * width * channels; x < width; ++x, at += channels) {
      for (let c = 0; c < 3; ++c) {
        const radiance = pixels[at + (channels < 3 ? 0 : c)];
        for (let k = 0; k < 2 * ORDER - 1; ++k) row[3 * k + c] += radiance * waves[k][x];
      }
    }
    addRow(light, row, Math.PI * y / height, Math.PI / height, step, nodes);
  }
  // So far z was up: (x, -z, y)
  return rotate(light, [1, 0, 0, 0, 0, -1, 0, 1, 0]);
}

// cos mφ and sin mφ at the middle of every column, m = 0 … 4, φ = π - 2π u.
function waveTables(width) {
  const phi = (x) => Math.PI - 2 * Math.PI * (x + 0.5) / width;
  const table = (wave, m) => Float64Array.from({ length: width }, (_, x) => wave(m * phi(x)));
  const m = [...Array(ORDER).keys()];
  return [...m.map((k) => table(Math.cos, k)), ...m.slice(1).map((k) => table(Math.sin, k))];
}

function addRow(light, row, theta, size, step, nodes) {
  for (const { x, weight } of nodes) {
    const angle = theta + size * (x + 1) / 2, sine = Math.sin(angle);
    let sectoral = Math.sqrt(0.25 / Math.PI);
    for (let m = 0; m < ORDER; ++m) {
      if (m) sectoral *= Math.sqrt((2 * m + 1) / (2 * m));
      const patch = m ? 2 * Math.sin(m * step / 2) / m * Math.SQRT2 : step;
      const factor = patch * sine ** m * sine * weight * size / 2;
      legendre(Math.cos(angle), m, ORDER, sectoral, (l, value) => {
        for (let c = 0; c < 3; ++c) {
          light[l * (l + 1) + m][c] += value * factor * row[3 * m + c];
          if (m) light[l * (l + 1) - m][c] += value * factor * row[3 * (ORDER - 1 + m) + c];
        }
      });
    }
  }
}
