"""The directions that a point traces: one local set for all points, and the turn to each normal.

A point's frame is Rz(phi) Ry(theta) Rz(azimuth), the normal being Rz(phi) Ry(theta) z.  Local
coefficients are summed with one product for many points and then turned to world axes, which is
far cheaper than evaluating the basis for every ray.
"""

from dataclasses import dataclass
from functools import lru_cache
from math import pi

import numpy as np
import numpy.typing as npt

from .. import sh

Array = npt.NDArray[np.float32]
GOLDEN_ANGLE = pi * (3 - 5**0.5)
GROUP = 16  # points whose rays and sums are one product


@dataclass(frozen=True)
class HemisphereSet:
    """``directions`` (N, 3) about +z and ``weights`` (N, n²): the transfer of a point in its own
    frame is the sum of the weights of the directions that reach the sky."""

    directions: Array
    weights: Array


def cosine_fibonacci(count: int) -> npt.NDArray[np.float64]:
    """Directions (N, 3) about +z, density cos / pi: a Fibonacci lattice on the disc, lifted."""
    i = np.arange(count)
    squared_radius = (i + 0.5) / count
    radius, phi = np.sqrt(squared_radius), i * GOLDEN_ANGLE
    return np.stack(
        [radius * np.cos(phi), radius * np.sin(phi), np.sqrt(1 - squared_radius)], axis=1
    )


@lru_cache(maxsize=4)  # of the pilots, the bake and the estimate
def hemisphere_set(count: int, order: int) -> HemisphereSet:
    """``count`` cosine-distributed directions with weights that are exact under an open sky.

    Every weight gets the same share of what the set misses of the open transfer: that is the
    correction ``T + v (T_open - mean Y)`` with v the visible fraction, at no cost.  The arrays are
    read-only.
    """
    directions = cosine_fibonacci(count)
    values = sh.basis(directions, order)
    missing = sh.open_transfer(np.array([0.0, 0.0, 1.0]), order) - values.mean(axis=0)
    found = directions.astype(np.float32), ((values + missing) / count).astype(np.float32)
    for array in found:
        array.setflags(write=False)
    return HemisphereSet(*found)


@dataclass(frozen=True)
class Frames:
    """Cosines and sines (P,) of theta, phi and azimuth of P local frames."""

    cos_theta: Array
    sin_theta: Array
    cos_phi: Array
    sin_phi: Array
    cos_azimuth: Array
    sin_azimuth: Array

    def matrices(self) -> Array:
        """Rotations (P, 3, 3) from local to world; the third column is the normal."""
        ct, st, cp, sp = self.cos_theta, self.sin_theta, self.cos_phi, self.sin_phi
        ca, sa = self.cos_azimuth, self.sin_azimuth
        x, y = ct * cp, ct * sp  # of the tangent before it is turned
        rows = np.empty((3, 3, len(ct)), np.float32)
        rows[0] = ca * x - sa * sp, -ca * sp - sa * x, st * cp
        rows[1] = ca * y + sa * cp, ca * cp - sa * y, st * sp
        rows[2] = -ca * st, sa * st, ct
        return np.ascontiguousarray(rows.transpose(2, 0, 1))

    def __getitem__(self, part: slice) -> "Frames":
        return Frames(*(values[part] for values in vars(self).values()))


def frames(normals: npt.ArrayLike, azimuth: npt.ArrayLike) -> Frames:
    """Frames about unit ``normals`` (P, 3), turned by ``azimuth`` (P,) radians about them."""
    n, angle = np.asarray(normals, np.float64), np.asarray(azimuth, np.float32)
    x, y = n[:, 0], n[:, 1]
    sine = np.sqrt(x * x + y * y)
    at_pole = sine == 0  # there phi is 0
    divisor = sine + at_pole
    values = n[:, 2], sine, (x + at_pole) / divisor, y / divisor, np.cos(angle), np.sin(angle)
    return Frames(*(np.asarray(v, np.float32) for v in values))


class RaysInWorld:
    """The rays of many points as two products, ray by ray as Embree reads them.

    Row p of the (P, 9) frames times a (9, 3N) arrangement of the set gives the N directions of
    point p; row p of the (P, 3) origins times N identities side by side repeats its origin.  Both
    cost a tenth of what numpy's broadcasting costs for rows of three.
    """

    def __init__(self, directions: Array) -> None:
        self.count = count = len(directions)
        arranged = np.zeros((3, 3, count, 3), np.float32)
        for c in range(3):
            arranged[c, :, :, c] = directions.T
        self._arranged = arranged.reshape(9, 3 * count)
        self._columns = np.ascontiguousarray(directions.T)
        self._repeat = np.tile(np.eye(3, dtype=np.float32), count)

    def directions(self, matrices: Array, out: Array, first: int = 0) -> None:
        """Directions of frames (P, 3, 3) into ``out`` (P * N, 3), without the ``first`` of each."""
        arranged = self._arranged[:, 3 * first :]
        _in_groups(matrices.reshape(-1, 9), arranged, out.reshape(-1, arranged.shape[1]), GROUP)

    def planes(self, matrices: Array, out: Array) -> None:
        """Directions of frames (P, 3, 3) into ``out`` (P, 3, N), axis by axis as numpy reads
        them."""
        rows, values = matrices.reshape(-1, 3), out.reshape(-1, self.count)
        _in_groups(rows, self._columns, values, 3 * GROUP)

    def origins(self, origins: Array, out: Array, first: int = 0) -> None:
        """``origins`` (P, 3), each N times less ``first``, into ``out`` (P * N, 3)."""
        repeat = self._repeat[:, 3 * first :]
        np.matmul(origins, repeat, out=out.reshape(len(origins), repeat.shape[1]))


def _in_groups(rows: Array, table: Array, out: Array, size: int) -> None:
    """``rows`` (R, K) times ``table`` (K, C) into ``out`` (R, C): products of ``size`` rows each,
    so that a point's directions are the same bits in any company."""
    whole = len(rows) // size * size
    by_group = rows[:whole].reshape(-1, size, rows.shape[1])
    np.matmul(by_group, table, out=out[:whole].reshape(-1, size, table.shape[1]))
    if whole < len(rows):
        last = np.zeros((size, rows.shape[1]), np.float32)
        last[: len(rows) - whole] = rows[whole:]
        out[whole:] = (last @ table)[: len(rows) - whole]


@lru_cache(maxsize=4)  # as of the sets
def rays_in_world(count: int) -> RaysInWorld:
    """Those of the set of ``count`` directions."""
    return RaysInWorld(cosine_fibonacci(count).astype(np.float32))


@lru_cache
def _quarter_turn(order: int) -> Array:
    """The turn about x (n², n²) of coefficients."""
    quarter = np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]])
    return sh.rotation_matrix(quarter, order).astype(np.float32)


class Turn:
    """Turns local coefficients to world axes: Dz(phi) J' Dz(theta) J Dz(azimuth), in which J, the
    quarter turn about x, is a constant."""

    def __init__(self, order: int) -> None:
        self._order, self._quarter = order, _quarter_turn(order)

    def __call__(self, frames: Frames, local: Array) -> Array:
        """World coefficients (P, n²) of ``local`` (P, n²)."""
        values = self._about_z(frames.cos_azimuth, frames.sin_azimuth, local.T.copy())
        values = self._about_z(frames.cos_theta, frames.sin_theta, self._quarter @ values)
        values = self._quarter.T @ values
        return self._about_z(frames.cos_phi, frames.sin_phi, values).T

    def _about_z(self, cosine: Array, sine: Array, values: Array) -> Array:
        """Rows of coefficients (n², P), turned."""
        turned, c, s = values.copy(), cosine, sine
        for m in range(1, self._order):
            for band in range(m, self._order):
                even, odd = sh.index(band, m), sh.index(band, -m)
                turned[even] = c * values[even] - s * values[odd]
                turned[odd] = s * values[even] + c * values[odd]
            c, s = c * cosine - s * sine, s * cosine + c * sine
        return turned
