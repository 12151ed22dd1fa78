"""Suns, lamps and softboxes cut out of a lat-long map, as lights of their own.

What spherical harmonics of a low order lose is mostly the few bright and small things in a map.
What is brighter than its surroundings within a disc is taken out; of the discs about the brightest
places, in four sizes, the one that leaves the smallest error is chosen, again and again.  The error
is that of the coefficients in the light of random wedges: surfaces that see the half of the sky
above them on one side of a plane, as beside a wall.  It needs no scene.
"""

from dataclasses import dataclass
from math import acos, ceil, gcd, pi, radians, sqrt

import numpy as np
import numpy.typing as npt

from .. import sh
from ..job import LIGHT_ORDER, Peak
from . import lat_long
from .map_sampler import LUMINANCE, SETS, Blocks, Candidates, Drawn, MapSampler

Array = npt.NDArray[np.float32]
Float = npt.NDArray[np.float64]
Index = npt.NDArray[np.int64]

RADII = (4.0, 8.0, 15.0, 25.0)  # degrees
RING = 1.5  # times the radius: what surrounds a disc
PLACES = 6  # discs of a radius that are tried
WORTH = 0.03  # of the remaining error: what a peak saves at least
TEXELS = 1 << 19  # of the map that peaks are looked for in
CELLS = 1 << 13  # of the map that the error is found with
WEDGES = 512
STEPS = 3  # towards the middle of a disc's light
CENTRES = 3  # every so many cells, one is tried as a disc's centre
RAYS = 32
GROUPS = 64


@dataclass(frozen=True)
class CutOut:
    """``peaks`` in world axes; ``cut_sh`` (25, 3), radiance coefficients of the world without them,
    and ``peak_sh`` (peaks, 25, 3), those of exactly what was taken out: together the world's own.
    ``removed`` (peaks, h, w, 3) are lat-long maps of that, unrotated and without strength.
    """

    peaks: tuple[Peak, ...]
    cut_sh: Float
    peak_sh: Float
    removed: Array
    rotation: Float
    strength: Float

    def rest(self, pixels: Array) -> Array:
        """``pixels`` (H, W, 3), which the peaks were found in, without their light: every texel
        keeps the share that the reduced map keeps of its own."""
        removed = self.removed.sum(axis=0)
        whole = _reduced(pixels)
        share = np.divide(removed, whole, out=np.zeros_like(removed), where=whole > 0)
        side = len(pixels) // len(removed)
        kept = np.clip(1 - share, 0, 1)
        return np.asarray(pixels * np.repeat(np.repeat(kept, side, axis=0), side, axis=1))

    def rays(self, count: int = RAYS, seed: int = 0) -> "PeakRays":
        """``count`` rays a point to each of the peaks."""
        return PeakRays(self, count, seed)


def find(
    pixels: Array,
    rotation: npt.ArrayLike,
    strength: npt.ArrayLike,
    count: int,
    order: int = 3,
) -> CutOut:
    """Up to ``count`` peaks of ``strength * image(rotation @ direction)``, those that save a bake
    of ``order`` the most error; ``pixels`` (H, W, 3), finite, not negative, top row first."""
    turn, factor = np.asarray(rotation, np.float64), np.asarray(strength, np.float64)
    rest = _reduced(pixels)
    search = _Search(rest, order)
    removed: list[Array] = []
    while len(removed) < count and (light := search.next(rest)) is not None:
        rest = rest - light
        removed.append(light)
    lights = np.array(removed, np.float32).reshape(-1, *rest.shape)

    def radiance_sh(picture: Array) -> Float:
        return np.asarray(sh.rotate(lat_long.project(picture, LIGHT_ORDER), turn.T) * factor)

    peak_sh = np.array([radiance_sh(light) for light in lights]).reshape(-1, LIGHT_ORDER**2, 3)
    cut_sh = radiance_sh(pixels) - peak_sh.sum(axis=0)
    found = tuple(_peak(light, turn, factor) for light in lights)
    return CutOut(found, cut_sh, peak_sh, lights, turn, factor)


def _reduced(pixels: Array) -> Array:
    """``pixels``, as means of whole squares of texels where there are very many."""
    height, width = pixels.shape[:2]
    both, least = gcd(height, width), ceil(sqrt(height * width / TEXELS))
    side = next((d for d in range(least, both + 1) if both % d == 0), 1)
    if side == 1:
        return pixels
    blocks = Blocks.of(pixels, height * width // side**2)
    return np.asarray(blocks.flux / blocks.solid_angles()[..., None], np.float32)


def _peak(light: Array, rotation: Float, strength: Float) -> Peak:
    """The disc of constant radiance with the flux and the mean direction of a map of ``light``."""
    vectors, flux = _moments(light)
    along = vectors @ LUMINANCE
    length = float(np.linalg.norm(along))
    x, y, z = rotation.T @ (along / length)
    facing = min(1.0, length / float(flux @ LUMINANCE))  # (1 + cos radius) / 2 of a disc
    red, green, blue = strength * flux * facing
    radius = acos(2 * facing - 1)
    return Peak((float(x), float(y), float(z)), (float(red), float(green), float(blue)), radius)


def _moments(light: Array) -> tuple[Float, Float]:
    """The integrals of direction times a map (3, 3), axes by channels, and of the map (3,)."""
    height, width = light.shape[:2]
    flux = light * lat_long.row_solid_angles(height, width)[:, None, None]
    directions = lat_long.directions(height, width).reshape(-1, 3)
    return directions.T @ flux.reshape(-1, 3), flux.sum(axis=(0, 1))


class _Search:
    """Looks for peaks in a map of the shape of ``pixels``."""

    def __init__(self, pixels: Array, order: int) -> None:
        self._height, self._width = pixels.shape[:2]
        self._directions = lat_long.directions(self._height, self._width)
        self._solid_angles = lat_long.row_solid_angles(self._height, self._width)
        blocks = Blocks.of(pixels, CELLS)
        self._side = blocks.side
        theta = 0.5 * (blocks.theta[1:] + blocks.theta[:-1])
        phi = 0.5 * (blocks.phi[1:] + blocks.phi[:-1])
        sine = np.sin(theta)[:, None]
        z = np.broadcast_to(np.cos(theta)[:, None], blocks.flux.shape[:2])
        cells = np.stack([sine * np.cos(phi), sine * np.sin(phi), z], axis=-1)
        self._cells = cells.reshape(-1, 3)
        self._centres = cells[1::CENTRES, 1::CENTRES].reshape(-1, 3)
        self._missed = _missed(self._cells, blocks.solid_angles().ravel(), order)

    def next(self, rest: Array) -> Array | None:
        """The light to be cut out of ``rest`` (h, w, 3), as a map; None where none is worth it."""
        flux = self._flux(rest, slice(0, self._height))
        error = self._missed @ flux
        least, best = (1 - WORTH) ** 2 * float((error**2).sum()), None
        for radius in RADII:
            for centre in self._brightest(flux, radians(radius)):
                rows, light = self._above_its_surroundings(rest, centre, radians(radius))
                cells = self._cells_of(rows)
                left = error - self._missed[:, cells] @ self._flux(light, rows)
                if (squared := float((left**2).sum())) < least:
                    least, best = squared, (rows, light)
        if best is None:
            return None
        found = np.zeros_like(rest)
        found[best[0]] = best[1]
        return found

    def _flux(self, light: Array, rows: slice) -> Float:
        """Flux (cells, 3) of the cells of ``rows``, which begin with a cell, of a map."""
        flux = light * self._solid_angles[rows, None, None]
        sums = np.add.reduceat(flux, np.arange(0, len(flux), self._side), axis=0)
        return np.add.reduceat(sums, np.arange(0, self._width, self._side), axis=1).reshape(-1, 3)

    def _cells_of(self, rows: slice) -> slice:
        """The cells of ``rows``, which begin with one."""
        columns = -(-self._width // self._side)
        return slice(rows.start // self._side * columns, -(-rows.stop // self._side) * columns)

    def _brightest(self, flux: Float, radius: float) -> list[Float]:
        """Directions in which discs of ``radius`` radians hold the most light, apart by that."""
        light = flux @ LUMINANCE
        near = self._centres @ self._cells.T > np.cos(radius)
        inside = near @ light
        chosen: list[Float] = []
        for place in np.argsort(inside)[::-1]:
            towards = self._centres[place]
            if all(towards @ other < np.cos(radius) for other in chosen):
                chosen.append(towards)
            if len(chosen) == PLACES:
                break
        return chosen

    def _above_its_surroundings(
        self, rest: Array, centre: Float, radius: float
    ) -> tuple[slice, Array]:
        """What is brighter than the ring about it in a disc at its own middle, near ``centre``: the
        rows of the map that it is in, and the light (rows, w, 3) there."""
        for step in range(STEPS):
            rows = self._rows(centre, RING * radius)
            cosine = self._directions[rows] @ centre
            ring = (cosine < np.cos(radius)) & (cosine > np.cos(RING * radius))
            inside = cosine >= np.cos(radius)
            level = np.median(rest[rows][ring], axis=0) if ring.any() else np.zeros(3)
            light = np.maximum(rest[rows] - level, 0) * inside[..., None]
            weight = (light @ LUMINANCE) * self._solid_angles[rows, None]
            towards = np.einsum("hw,hwc->c", weight, self._directions[rows])
            length = float(np.linalg.norm(towards))
            if step + 1 < STEPS and length > 0:
                centre = towards / length
        return rows, light.astype(np.float32)

    def _rows(self, centre: Float, radius: float) -> slice:
        """The rows that a disc may touch, whole cells of them."""
        theta = acos(float(np.clip(centre[2], -1, 1)))
        step, side = pi / self._height, self._side
        first = max(0, int((theta - radius) / step) - 1) // side
        last = min(self._height, ceil((theta + radius) / step) + 1)
        return slice(first * side, min(self._height, -(-last // side) * side))


def _missed(directions: Float, solid_angles: Float, order: int) -> Float:
    """What coefficients of ``order`` miss of the exit radiance of wedges (WEDGES, cells) for unit
    flux from ``directions`` (cells, 3): clamped cosine and a wall's edge, less their own series."""
    random = np.random.default_rng(0)
    normals, walls = random.normal(size=(2, WEDGES, 3))
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    seen = np.maximum(0, normals @ directions.T) * (walls @ directions.T > 0) / pi
    basis = sh.basis(directions, order)
    return np.asarray(seen - (seen * solid_angles) @ basis @ basis.T)


class PeakRays:
    """Rays towards the peaks of a ``cut``, ``count`` for each of them and point, drawn from the
    light that was taken out, and what comes of them."""

    def __init__(self, cut: CutOut, count: int, seed: int) -> None:
        self.peaks, self._count = len(cut.peaks), count
        weights = LUMINANCE * np.abs(cut.strength)
        if not weights.any():
            weights = LUMINANCE
        sets = [
            MapSampler(light, weights, 0.0).shifted_sets(count, seed + k).directions @ cut.rotation
            for k, light in enumerate(cut.removed)
        ]
        directions = np.concatenate([np.empty((SETS, 0, 3)), *sets], axis=1)
        self._candidates = Candidates(directions.astype(np.float32))
        # in the order of the map's light, set by set and stratum by stratum
        groups = [
            np.swapaxes(one, 0, 1).reshape(GROUPS, -1, 3).mean(axis=1) / GROUPS for one in sets
        ]
        facing = [g.sum(axis=0) @ p.direction for g, p in zip(groups, cut.peaks, strict=True)]
        self._groups = [g / f for g, f in zip(groups, facing, strict=True)]

    def drawn(self, normals: Array, picks: Index, open_above: float = 2.0) -> Drawn:
        """The rays that points with ``normals`` (P, 3) trace, whose directions with a cosine above
        ``open_above`` reach the sky; ``picks`` (P,), any numbers, choose each point's set."""
        return self._candidates.drawn(normals, picks, open_above)

    def open_cosine(self, normals: Array) -> Array:
        """``shadowed_cosine`` where nothing is in the way."""
        n = normals.astype(np.float64)
        total = np.zeros((len(n), self.peaks))
        for k, vectors in enumerate(self._groups):
            x, y, z = vectors.T
            along = n[:, 0, None] * x + n[:, 1, None] * y + n[:, 2, None] * z
            total[:, k] = np.maximum(0, along).sum(axis=1)
        return total.astype(np.float32)

    def shadowed_cosine(
        self, normals: Array, drawn: Drawn, visible: npt.NDArray[np.generic]
    ) -> Array:
        """Irradiance (P, peaks) by each peak over that of an open surface that faces it, weighted
        by luminance; ``visible`` (R,) says which of the rays ``drawn`` reach the sky."""
        shape = (len(normals), self.peaks, self._count)
        whole = drawn.cosines.reshape(shape).sum(axis=2)
        part = (drawn.cosines * drawn.spread(visible)).reshape(shape).sum(axis=2)
        share = np.divide(part, whole, out=np.zeros_like(part), where=whole > 0)
        return np.asarray(share * self.open_cosine(normals))
