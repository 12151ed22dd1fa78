"""Directions of a lat-long map, drawn in proportion to its luminance.

Texels stand along a Hilbert curve, so that equal steps of their cumulated luminance are compact
patches of the map: one number in [0, 1) chooses the texel, and what is left of it the place inside
along a second curve.  N numbers (i + shift) / N are then a stratified sample of the map's light.
A large map is chosen from in two steps, blocks of texels and the texels inside, so that the curve's
memory stays bounded.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from functools import lru_cache
from math import ceil, pi, sqrt
from typing import Any

import numpy as np
import numpy.typing as npt

Float = npt.NDArray[np.float64]
Index = npt.NDArray[np.int64]
Array = npt.NDArray[np.float32]

LUMINANCE = np.array([0.2126, 0.7152, 0.0722])  # of linear Rec.709
FLOOR = 1e-3  # of the mean luminance, added to it: no direction is left out
BLOCKS = 1 << 21  # at most about so many: 2048 x 1024 texels are their own blocks
ROWS = 64  # of texels, summed at a time
SETS = 256
PLACES_AT_ONCE = 1 << 17
PLACES = 8  # bits of the curve inside a texel


@lru_cache(maxsize=2)
def hilbert(bits: int) -> Index:
    """The place (2^bits, 2^bits) of each cell along a Hilbert curve; neighbours along it share a
    side, and its first half fills the first half of the rows."""
    curve = np.zeros((1, 1), np.int64)
    for _ in range(bits):
        part = curve.size
        last = curve[::-1, ::-1].T + 3 * part
        curve = np.block([[curve.T, curve + part], [last, curve + 2 * part]])
    return curve


def along_hilbert(rows: int, columns: int) -> Index:
    """The cells (rows * columns,) of a grid, as flat numbers, in the order of the curve."""
    curve = hilbert(int(max(rows, columns) - 1).bit_length())
    cells = np.full(curve.size, -1, np.int64)
    cells[curve[:rows, :columns]] = np.arange(rows * columns).reshape(rows, columns)
    return cells[cells >= 0]


@dataclass(frozen=True)
class Blocks:
    """A map (H, W, 3) as h x w blocks of ``side`` x ``side`` texels, smaller at the right and at
    the bottom: ``flux`` (h, w, 3), the integral of the pixels over solid angle, ``theta`` (h + 1,)
    and ``phi`` (w + 1,) of their edges, theta rising from the top and phi falling from pi."""

    side: int
    flux: Float
    theta: Float
    phi: Float

    @classmethod
    def of(cls, pixels: npt.NDArray[np.float32], limit: int = BLOCKS) -> "Blocks":
        """Blocks of ``pixels``, about ``limit`` of them at most."""
        height, width = pixels.shape[:2]
        side = max(1, ceil(sqrt(height * width / limit)))
        rows, columns = np.arange(0, height, side), np.arange(0, width, side)
        flux = np.empty((len(rows), len(columns), 3))
        solid_angle = 2 * pi / width * _falls(np.arange(height + 1) * pi / height)
        for first in range(0, len(rows), ROWS):
            part = rows[first : first + ROWS]
            texels = slice(part[0], min(part[-1] + side, height))
            light = pixels[texels] * solid_angle[texels, None, None]
            light = np.add.reduceat(light, part - part[0], axis=0)
            flux[first : first + ROWS] = np.add.reduceat(light, columns, axis=1)
        theta = np.append(rows, height) * (pi / height)
        return cls(side, flux, theta, pi - np.append(columns, width) * (2 * pi / width))

    def solid_angles(self) -> Float:
        """Solid angles (h, w) of the blocks."""
        return np.asarray(_falls(self.theta)[:, None] * -np.diff(self.phi))

    def flux_and_solid_angle(self) -> Float:
        """Both (h, w, 4) of the blocks."""
        return np.concatenate([self.flux, self.solid_angles()[..., None]], axis=-1)

    def at(self, directions: Float) -> tuple[Index, Index]:
        """Row and column of the blocks that ``directions`` (..., 3) lie in."""
        theta = np.arccos(np.clip(directions[..., 2], -1, 1))
        phi = np.arctan2(directions[..., 1], directions[..., 0])
        row = np.searchsorted(self.theta[1:-1], theta, side="right")
        return row, np.searchsorted(-self.phi[1:-1], -phi, side="right")

    def places(self, rows: int) -> Iterator[tuple[Float, Float]]:
        """Parts of the map, about ``rows`` rows of them or more: directions (S, 3) of their
        middles, their flux and solid angle (S, 4)."""
        split = max(1, ceil(rows / self.flux.shape[0]))
        both = self.flux_and_solid_angle()
        theta, phi = _split(self.theta, split), _split(self.phi, split)
        share = _falls(theta).reshape(-1, split) / _falls(self.theta)[:, None] / split
        azimuth = 0.5 * (phi[1:] + phi[:-1])
        across = np.stack([np.cos(azimuth), np.sin(azimuth), np.ones_like(azimuth)])
        middle = 0.5 * (theta[1:] + theta[:-1])
        sine, cosine = np.sin(middle).reshape(-1, split), np.cos(middle).reshape(-1, split)
        step = max(1, PLACES_AT_ONCE // (len(azimuth) * split))
        for first in range(0, len(both), step):
            part = slice(first, first + step)
            down = np.stack([sine[part], sine[part], cosine[part]]).reshape(3, -1, 1)
            directions = np.moveaxis(down * across[:, None], 0, -1)
            weights = both[part, None, :, None] * share[part, :, None, None, None]
            weights = np.broadcast_to(weights, (*weights.shape[:3], split, 4))
            yield directions.reshape(-1, 3), weights.reshape(-1, 4)


def _split(edges: Float, count: int) -> Float:
    """Edges of ``count`` equal parts of each interval."""
    at = np.arange((len(edges) - 1) * count + 1) / count
    return np.asarray(np.interp(at, np.arange(len(edges)), edges))


def _falls(theta: Float) -> Float:
    """Differences cos t0 - cos t1 of neighbours: a product, which keeps its digits at the poles."""
    middle, half = 0.5 * (theta[1:] + theta[:-1]), 0.5 * np.diff(theta)
    return np.asarray(2 * np.sin(middle) * np.sin(half))


@dataclass(frozen=True)
class Samples:
    """Unit ``directions`` (..., 3) in the map's axes, the ``pixels`` (..., 3) there, and the
    ``density`` (...) per steradian with which they were drawn."""

    directions: Float
    pixels: Float
    density: Float


class MapSampler:
    """Draws directions of ``pixels`` (H, W, 3), finite and not negative, with the density
    ``weights · pixel + floor`` over its integral, where ``floor`` is ``FLOOR`` or the share given
    of the mean of ``weights · pixel``, and 1 for a map without any."""

    def __init__(
        self,
        pixels: npt.NDArray[np.float32],
        weights: npt.ArrayLike = LUMINANCE,
        floor: float = FLOOR,
    ) -> None:
        self._pixels, self.blocks = pixels, Blocks.of(pixels)
        self._weights = np.asarray(weights, np.float64)
        light = self.blocks.flux @ self._weights
        total = float(light.sum())
        self._floor = floor * total / (4 * pi) if total > 0 else 1.0
        self.total = total + 4 * pi * self._floor
        self._order = along_hilbert(*light.shape)
        shares = (light + self._floor * self.blocks.solid_angles()).ravel()[self._order]
        self._cumulated = np.concatenate([[0.0], np.cumsum(shares)])

    def density(self, pixels: npt.ArrayLike) -> Float:
        """Density (...) per steradian where the map is ``pixels`` (..., 3)."""
        return (np.asarray(pixels, np.float64) @ self._weights + self._floor) / self.total

    def shifted_sets(self, count: int, seed: int) -> Samples:
        """``SETS`` samples (SETS, count) of the map, each stratified, shifted against the others
        by equal steps."""
        random = np.random.default_rng([seed, count])
        shift = (np.arange(SETS) + random.random(SETS)) / SETS
        chosen = (np.arange(count) + shift[:, None]) / count
        return self.sample(chosen, random)

    def sample(self, chosen: Float, random: np.random.Generator) -> Samples:
        """The samples (...) that numbers ``chosen`` (...) in [0, 1) stand for."""
        wanted = chosen.ravel() * self._cumulated[-1]
        found = np.searchsorted(self._cumulated, wanted, side="right") - 1
        found = np.clip(found, 0, len(self._order) - 1)
        rest = wanted - self._cumulated[found]
        row, column, inside = self._texels(self._order[found], rest)
        directions = self._places(row, column, inside, random)
        pixels = self._pixels[row, column].astype(np.float64)
        shape = chosen.shape
        return Samples(
            directions.reshape(*shape, 3),
            pixels.reshape(*shape, 3),
            self.density(pixels).reshape(shape),
        )

    def _texels(self, blocks: Index, rest: Float) -> tuple[Index, Index, Float]:
        """Row and column of the texel of each block that ``rest``, a part of the block's light,
        falls into, and how far into it, 0 .. 1."""
        height, width = self._pixels.shape[:2]
        side, columns = self.blocks.side, self.blocks.flux.shape[1]
        step = np.arange(side * side)
        row = (blocks // columns * side)[:, None] + step // side
        column = (blocks % columns * side)[:, None] + step % side
        exists = (row < height) & (column < width)
        row, column = np.minimum(row, height - 1), np.minimum(column, width - 1)
        solid_angle = 2 * pi / width * _falls(np.arange(height + 1) * pi / height)
        light = self._pixels[row, column] @ self._weights + self._floor
        cumulated = np.cumsum(light * solid_angle[row] * exists, axis=1)
        last = exists.cumsum(axis=1).argmax(axis=1)
        texel = np.minimum((cumulated <= rest[:, None]).sum(axis=1), last)  # rest may be rounded up
        samples = np.arange(len(blocks))
        start = np.where(texel > 0, cumulated[samples, np.maximum(texel - 1, 0)], 0)
        inside = np.clip((rest - start) / (cumulated[samples, texel] - start), 0, 1)
        return row[samples, texel], column[samples, texel], inside

    def _places(
        self, row: Index, column: Index, inside: Float, random: np.random.Generator
    ) -> Float:
        """Directions (S, 3) inside of texels, uniform in solid angle, along a curve."""
        height, width = self._pixels.shape[:2]
        cells = 1 << PLACES
        along = np.minimum(inside * cells**2, cells**2 - 1).astype(np.int64)
        corner = np.stack(np.divmod(along_hilbert(cells, cells)[along], cells))
        down, right = (corner + random.random(corner.shape)) / cells
        top, bottom = np.cos(row * pi / height), np.cos((row + 1) * pi / height)
        z = top + down * (bottom - top)
        phi = pi - (column + right) * (2 * pi / width)
        sine = np.sqrt(np.maximum(0, 1 - z * z))
        return np.stack([sine * np.cos(phi), sine * np.sin(phi), z], axis=1)


@dataclass(frozen=True)
class Drawn:
    """Rays of the map that P points trace: the ``sets`` (P,) that they took, the ``cosines`` (P, N)
    of all of a set's directions to the point's normal, 0 below its horizon, and which of them are
    known to reach the sky, ``is_open`` (P, N).  Of the R others above the horizon, point by point,
    their ``places`` (R,) among all, the ``point`` (R,) and the ``directions`` (R, 3)."""

    sets: Index
    cosines: Array
    is_open: npt.NDArray[np.bool_]
    places: Index
    point: Index
    directions: Array

    def spread(self, visible: npt.NDArray[Any]) -> Array:
        """Of all directions (P, N) which reach the sky, 1 or 0, as ``visible`` (R,) says it of the
        rays; 0 below the horizon."""
        found = self.is_open.astype(np.float32)
        found.reshape(-1)[self.places] = visible
        return found


class Candidates:
    """Sets of ``directions`` (SETS, N, 3), of which each point takes one: those above its horizon
    are its rays."""

    def __init__(self, directions: npt.NDArray[np.float32]) -> None:
        self._directions = np.ascontiguousarray(directions).reshape(-1, 3)
        self._planes = np.ascontiguousarray(np.moveaxis(directions, 2, 0))

    def drawn(self, normals: Array, picks: Index, open_above: float) -> Drawn:
        """The rays of points with ``normals`` (P, 3) and the sets ``picks`` (P,), any numbers, but
        those that reach the sky because their cosine is beyond ``open_above``: the same bits
        however points are batched."""
        sets = picks % SETS
        cosines: Array = self._planes[0].take(sets, axis=0) * normals[:, 0, None]
        cosines += self._planes[1].take(sets, axis=0) * normals[:, 1, None]
        cosines += self._planes[2].take(sets, axis=0) * normals[:, 2, None]
        np.maximum(cosines, 0, out=cosines)
        is_open = cosines > open_above
        is_ray = (cosines > 0) & ~is_open
        places, of_each = np.flatnonzero(is_ray), np.count_nonzero(is_ray, axis=1)
        numbers = np.arange(len(sets))
        ahead = (sets - numbers) * cosines.shape[1]  # of its own place is its set's
        directions = self._directions.take(places + np.repeat(ahead, of_each), axis=0)
        point = np.repeat(numbers, of_each)
        return Drawn(sets, cosines, is_open, places, point, directions)
