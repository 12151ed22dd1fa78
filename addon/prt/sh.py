"""Real spherical harmonics: the basis, its index and its rotation.

Every convention of this package about the basis is here.

- Real and orthonormal over the sphere, **without the Condon-Shortley phase**: ``Y(1, 1)`` grows
  with +x, ``Y(1, -1)`` with +y, ``Y(1, 0)`` with +z.
- ``order`` n is the number of bands; bands l = 0 .. n - 1 hold n² coefficients.
- Coefficient (l, m) is stored at ``index(l, m) = l (l + 1) + m``, in the last axis of transfer
  vectors (P, n²) and in the first axis of light (n², 3).
- Positive m goes with cos(m phi), negative m with sin(|m| phi), phi from +x towards +y.
"""

from functools import lru_cache
from math import pi, sqrt

import numpy as np
import numpy.typing as npt

Float = npt.NDArray[np.float64]


def index(l: int, m: int) -> int:  # noqa: E741 - l is the field's letter
    """Place of coefficient (l, m)."""
    return l * (l + 1) + m


def basis(directions: npt.ArrayLike, order: int) -> Float:
    """Values (..., order²) of the first ``order`` bands at unit ``directions`` (..., 3), float64.

    Polynomials in x, y and z, so the poles need no care.  Three-term recurrence of the normalised
    associated Legendre functions: Press et al., Numerical Recipes, 3rd ed., 6.7.
    """
    xyz = np.asarray(directions, np.float64)
    x, y, z = xyz[..., 0], xyz[..., 1], xyz[..., 2]
    values = np.empty((*x.shape, order * order))
    sectoral = sqrt(0.25 / pi)
    cosine, sine = np.ones_like(x), np.zeros_like(x)
    for m in range(order):
        if m:
            sectoral *= sqrt((2 * m + 1) / (2 * m))
            cosine, sine = x * cosine - y * sine, x * sine + y * cosine
        before, legendre = np.zeros_like(x), np.full_like(x, sectoral)
        for l in range(m, order):  # noqa: E741
            if l > m:
                a = sqrt((4 * l * l - 1) / (l * l - m * m))
                b = sqrt(((l - 1) ** 2 - m * m) / (4 * (l - 1) ** 2 - 1))
                before, legendre = legendre, a * (z * legendre - b * before)
            if m == 0:
                values[..., index(l, 0)] = legendre
            else:
                values[..., index(l, m)] = sqrt(2) * legendre * cosine
                values[..., index(l, -m)] = sqrt(2) * legendre * sine
    return values


def evaluate(coefficients: npt.ArrayLike, directions: npt.ArrayLike) -> Float:
    """The function with ``coefficients`` (n², ...) at ``directions`` (..., 3)."""
    values = np.asarray(coefficients, np.float64)
    return basis(directions, order_of(len(values))) @ values


def order_of(count: int) -> int:
    """The order that has ``count`` coefficients; ValueError when ``count`` is no square."""
    order = round(sqrt(count))
    if order * order != count:
        raise ValueError(f"{count} is not a number of coefficients: it must be a square")
    return order


@lru_cache(maxsize=8)
def _quadrature(order: int) -> tuple[Float, Float]:
    """Directions (Q, 3) and weights (Q) that integrate products of two functions of ``order``."""
    z, weight = np.polynomial.legendre.leggauss(order)
    count = 2 * order
    phi = 2 * pi * np.arange(count) / count
    sine = np.sqrt(1 - z * z)
    x, y = np.outer(sine, np.cos(phi)), np.outer(sine, np.sin(phi))
    directions = np.stack([x, y, np.broadcast_to(z[:, None], x.shape)], axis=-1)
    return directions.reshape(-1, 3), np.repeat(weight * 2 * pi / count, count)


def rotation_matrix(rotation: npt.ArrayLike, order: int) -> Float:
    """The matrix D (n², n²) with ``basis(R w) = D basis(w)`` for an orthogonal R (3, 3).

    ``D @ coefficients`` turns a function with R: its value at R w is the old one at w.  Exact by
    quadrature, for reflections too.
    """
    directions, weight = _quadrature(order)
    turned = basis(directions @ np.asarray(rotation, np.float64).T, order)
    return turned.T @ (weight[:, None] * basis(directions, order))


def rotate(coefficients: npt.ArrayLike, rotation: npt.ArrayLike) -> Float:
    """Light (n², ...) turned with ``rotation`` (3, 3)."""
    values = np.asarray(coefficients, np.float64)
    return rotation_matrix(rotation, order_of(len(values))) @ values


def clamped_cosine(order: int) -> Float:
    """Zonal factors (order) of max(cos, 0): its projection about n is ``factor[l] Y(l, m)(n)``.

    pi, 2 pi / 3, pi / 4, 0, -pi / 24, ...; no 1/pi inside.  Ramamoorthi and Hanrahan 2001, eq. 8.
    """
    nodes, weight = np.polynomial.legendre.leggauss(2 * order + 2)
    cosine = 0.5 * (nodes + 1)
    legendre = np.polynomial.legendre.legvander(cosine, order - 1)
    return np.asarray(pi * (0.5 * weight * cosine * 2) @ legendre)


def bands(order: int) -> npt.NDArray[np.int64]:
    """The band l of each of the n² coefficients."""
    return np.repeat(np.arange(order), 2 * np.arange(order) + 1)


def open_transfer(normals: npt.ArrayLike, order: int) -> Float:
    """Transfer (..., n²) of a white surface under an open sky: 1/pi inside, albedo not."""
    return basis(normals, order) * (clamped_cosine(order) / pi)[bands(order)]
