"""Lat-long maps: their directions, their solid angles and their spherical harmonics.

Blender's convention, in the map's own frame with Z up: ``u = 0.5 - atan2(y, x) / 2 pi``,
``v = 0.5 + asin(z) / pi``, u to the right and v up.  The middle of the picture looks along +x, its
left quarter along +y.  Arrays (H, W, 3) hold the top row (+z) first.
"""

from functools import lru_cache
from math import ceil, pi

import numpy as np
import numpy.typing as npt

from .. import sh

Float = npt.NDArray[np.float64]
ROWS = 32  # reduced at a time: 3 MB in float64 for a map of 4096 columns


def row_solid_angles(height: int, width: int) -> Float:
    """Solid angle (H) in steradians of one texel of each row: ``dphi (cos t0 - cos t1)``."""
    centre = (np.arange(height) + 0.5) * pi / height
    # a product, where the difference of two cosines would lose digits at the poles
    return np.asarray(2 * pi / width * 2 * np.sin(centre) * np.sin(0.5 * pi / height))


def directions(height: int, width: int) -> Float:
    """Unit directions (H, W, 3) of the texels' centres."""
    theta = (np.arange(height)[:, None] + 0.5) * pi / height
    phi = _azimuths(width)
    sine = np.sin(theta)
    z = np.broadcast_to(np.cos(theta), (height, width))
    return np.stack([sine * np.cos(phi), sine * np.sin(phi), z], axis=-1)


def project(pixels: npt.NDArray[np.float32], order: int) -> Float:
    """Coefficients (n², 3) of a map (H, W, 3): the integral of ``pixels`` times the basis.

    A texel is constant over its solid angle and is integrated as such: exact in azimuth, by a
    quadrature to rounding in elevation.  Rows are reduced to their Fourier sums first, so the work
    a texel is 2 n - 1 multiplications.  Sums are float64.
    """
    height, width = pixels.shape[:2]
    fourier = _fourier_integrals(width, order)
    sums = np.empty((height, 3, 2 * order - 1))
    for row in range(0, height, ROWS):
        block = np.ascontiguousarray(pixels[row : row + ROWS].transpose(0, 2, 1), np.float64)
        sums[row : row + ROWS] = (block.reshape(-1, width) @ fourier).reshape(-1, 3, 2 * order - 1)
    places = [m + order - 1 for l in range(order) for m in range(-l, l + 1)]  # noqa: E741
    return np.asarray(np.einsum("ri,rci->ic", _row_integrals(height, order), sums[..., places]))


def _azimuths(width: int) -> Float:
    """Azimuth (W) of the columns' centres, from pi down to -pi."""
    return np.asarray(pi - (np.arange(width) + 0.5) * 2 * pi / width)


def _fourier_integrals(width: int, order: int) -> Float:
    """Integrals (W, 2 n - 1) over texels' azimuths of sin(|m| phi), 1 and cos(m phi), m rising."""
    phi, step = _azimuths(width), 2 * pi / width
    integrals = np.full((width, 2 * order - 1), step)
    for m in range(1, order):
        over_texel = 2 * np.sin(0.5 * m * step) / m
        integrals[:, order - 1 + m] = over_texel * np.cos(m * phi)
        integrals[:, order - 1 - m] = over_texel * np.sin(m * phi)
    return integrals


@lru_cache(maxsize=8)
def _row_integrals(height: int, order: int) -> Float:
    """Integrals (H, n²) over a row's z of the basis without its factor of azimuth.

    The integrand turns by at most ``order * pi / height`` radians over a row, which decides how
    many Gauss-Legendre nodes bring it to rounding.
    """
    half = 0.5 * pi / height
    nodes, weights = np.polynomial.legendre.leggauss(5 + ceil(2 * order * half))
    theta = (2 * np.arange(height)[:, None] + 1 + nodes) * half
    sine = np.sin(theta)
    meridian = np.stack([sine, np.zeros_like(theta), np.cos(theta)], axis=-1)
    values = np.einsum("rki,rk->ri", sh.basis(meridian, order), weights * half * sine)
    for l in range(order):  # noqa: E741
        for m in range(1, l + 1):
            values[:, sh.index(l, -m)] = values[:, sh.index(l, m)]
    return np.asarray(values)
