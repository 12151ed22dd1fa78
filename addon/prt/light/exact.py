"""The exact light of a lat-long map at points: what no affordable order of coefficients holds.

Two kinds of rays are combined by the balance heuristic (Veach and Guibas 1995): the transfer's own
cosine-distributed ones, and some drawn in proportion to the map.  Both are weighted as if every
direction were seen, too, and the light is the share that is visible of the unshadowed irradiance,
which is known: exact for a point that sees all, and free of the noise that both sums share.

The rays of the transfer are many, so the map's radiance and density for them come from a table of
cells, 2.5 degrees across: two discs, of directions up and down, in Lambert's equal-area projection.
The same table gives the density in the weights of the map's rays, so all weights of a direction add
up to 1 whatever the cells leave out.  Cells of half a degree are no better: what is fine in the map
is bright, and the map's own rays find it; the mean over a cell has less noise.
"""

from copy import copy
from math import pi
from typing import Any

import numpy as np
import numpy.typing as npt

from ..slices import slices
from .map_sampler import LUMINANCE, Blocks, Candidates, Drawn, MapSampler
from .open_irradiance import OpenIrradiance

Array = npt.NDArray[np.float32]
Float = npt.NDArray[np.float64]
Index = npt.NDArray[Any]

CELLS = 64  # across a disc
HALF = np.float32(0.5 * CELLS)
INSIDE = np.float32(0.49999 * CELLS)  # so that rounding stays within a disc's cells
TABLE_ROWS = 512  # of places that a map is averaged from
BATCH_RAYS = 65536  # whose arrays stay in the cache


def cells(x: Array, y: Array, z: Array) -> npt.NDArray[np.int32]:
    """The cells (...) of unit world directions with such coordinates (...) float32."""
    scale = np.abs(z)
    scale += np.float32(1)
    np.sqrt(scale, out=scale)
    np.divide(INSIDE, scale, out=scale)
    found = (x * scale + HALF).astype(np.int32)
    found *= CELLS
    found += (y * scale + HALF).astype(np.int32)
    found += (z < 0) * np.int32(CELLS * CELLS)
    return found


def _cell_centres() -> Float:
    """Unit directions (2 CELLS², 3) of the cells' centres, on the rim for those off the discs."""
    u = (np.arange(CELLS) + 0.5 - HALF) / HALF
    x, y = np.repeat(u, CELLS), np.tile(u, CELLS)
    outside = np.sqrt(np.maximum(1, x * x + y * y))
    x, y = x / outside, y / outside
    z = 1 - x * x - y * y
    upper = np.stack([x * np.sqrt(1 + z), y * np.sqrt(1 + z), z], axis=1)
    return np.concatenate([upper, upper * [1, 1, -1]])


class ExactLight:
    """``strength * image(rotation @ direction)`` on white surfaces, from the picture's own pixels.

    ``pixels`` (H, W, 3) float32, finite and not negative, are lat-long with the top row first.
    ``map_rays`` are drawn for a point, of which those below its horizon are dropped.
    """

    def __init__(
        self,
        pixels: Array,
        rotation: npt.ArrayLike,
        strength: npt.ArrayLike,
        map_rays: int,
        seed: int,
    ) -> None:
        self.map_rays = map_rays
        self._strength = np.asarray(strength, np.float64)
        self._sampler = MapSampler(pixels, LUMINANCE * np.abs(self._strength))
        largest = float(pixels.max())
        self._unit = largest if largest > 0 else 1.0  # float32 then holds every map's range
        self._samples = self._sampler.shifted_sets(map_rays, seed)
        self._open = OpenIrradiance(self._sampler.blocks)
        self.turn(np.asarray(rotation, np.float64))

    def turned(self, rotation: npt.ArrayLike) -> "ExactLight":
        """The same picture with another ``rotation``, sharing what doesn't depend on it."""
        other = copy(self)
        other.turn(np.asarray(rotation, np.float64))
        return other

    def turn(self, rotation: Float) -> None:
        """Make the tables in world axes: of the cells (2 CELLS², 4), radiance and density times
        ``map_rays``, and of the candidates."""
        self._rotation = rotation
        radiance = _mean_radiance(self._sampler.blocks, rotation)
        density = self._sampler.density(radiance) * self.map_rays
        table = np.concatenate([radiance / self._unit, density[:, None]], axis=1)
        self._table = table.astype(np.float32)
        samples = self._samples
        directions = (samples.directions @ rotation).astype(np.float32)
        self._candidates = Candidates(directions)
        # density of the cells, by which the weights go, over the one that drew the sample
        self._densities = self._table[cells(*np.moveaxis(directions, -1, 0)), 3]
        ratio = self._densities / (max(1, self.map_rays) * samples.density)
        self._values = (samples.pixels / self._unit * ratio[..., None]).astype(np.float32)

    def drawn(self, normals: Array, picks: npt.NDArray[np.int64], open_above: float = 2.0) -> Drawn:
        """The map's rays that points with ``normals`` (P, 3) float32 trace, whose directions with a
        cosine above ``open_above`` reach the sky; ``picks`` (P,), any numbers, choose each point's
        set, and with it whether neighbouring points make the same error."""
        return self._candidates.drawn(normals, picks, open_above)

    def open_exit_radiance(self, normals: npt.ArrayLike) -> Array:
        """Exit radiance (P, 3) of a white surface that sees the whole sky above ``normals``
        (P, 3)."""
        each = np.asarray(normals, np.float64)
        is_new = np.ones(len(each), bool)
        is_new[1:] = (each[1:] != each[:-1]).any(axis=1)  # on flat ground hardly any
        n = each[is_new]
        turned = np.stack(
            [n[:, 0] * r[0] + n[:, 1] * r[1] + n[:, 2] * r[2] for r in self._rotation], axis=1
        )
        found = np.asarray(self._open(turned) * (self._strength / pi), np.float32)
        return found.take(np.cumsum(is_new) - 1, axis=0)

    def exit_radiance(  # noqa: PLR0917 - all of a trace
        self,
        normals: Array,
        cosines: Array,
        directions: Array,
        visible: npt.NDArray[Any],
        drawn: Drawn,
        map_visible: npt.NDArray[Any],
    ) -> Array:
        """Exit radiance (P, 3) of white surfaces with ``normals`` (P, 3): E / pi.

        ``directions`` (P, 3, N) are cosine-distributed about the normals, with ``cosines`` (N,),
        and ``visible`` (P, N) where they reach the sky; ``map_visible`` (R,) which of the rays
        ``drawn`` do.
        """
        out = self.open_exit_radiance(normals)
        rays = max(1, len(cosines) + self.map_rays)
        of_map = drawn.spread(map_visible)
        for part in slices(len(normals), max(1, BATCH_RAYS // rays)):
            seen, whole = self._of_cosine_rays(cosines, directions[part], visible[part])
            its = drawn.cosines[part], drawn.sets[part], of_map[part]
            map_seen, map_whole = self._of_map_rays(*its, len(cosines))
            whole += map_whole
            seen += map_seen
            out[part] *= np.divide(seen, whole, out=np.zeros_like(seen), where=whole > 0)
        return out

    def _of_cosine_rays(
        self, cosines: Array, directions: Array, visible: npt.NDArray[Any]
    ) -> tuple[Array, Array]:
        """The sums (P, 3) over the transfer's own rays, and as if all of them were visible."""
        found = self._table.take(cells(*np.moveaxis(directions, 1, 0)), axis=0)
        weights = cosines / (cosines * np.float32(len(cosines) / pi) + found[..., 3])
        return _sums(weights, found[..., :3], visible)

    def _of_map_rays(
        self, cosines: Array, sets: Index, visible: Array, cosine_rays: int
    ) -> tuple[Array, Array]:
        """The sums (P, 3) over the map's rays, and as if all of them were visible."""
        densities = self._densities.take(sets, axis=0)
        weights = cosines / (cosines * np.float32(cosine_rays / pi) + densities)
        return _sums(weights, self._values.take(sets, axis=0), visible)


def _sums(weights: Array, values: Array, visible: npt.NDArray[Any]) -> tuple[Array, Array]:
    """Sums (P, 3) of ``weights`` (P, N) times ``values`` (P, N, 3), of what is visible and of all.

    One product of the same shape for each point, so that its bits don't depend on the others.
    """
    whole = np.matmul(weights[:, None], values)[:, 0]
    seen = np.matmul((weights * visible)[:, None], values)[:, 0]
    return seen, whole


def _mean_radiance(blocks: Blocks, rotation: Float) -> Float:
    """Mean pixels (2 CELLS², 3) of the cells in world axes, of a map that ``rotation`` turns."""
    sums = np.zeros((4, 2 * CELLS * CELLS))
    for directions, weights in blocks.places(TABLE_ROWS):
        found = cells(*(directions @ rotation).T.astype(np.float32))
        for c in range(4):
            sums[c] += np.bincount(found, weights[:, c], len(sums[c]))
    empty = np.flatnonzero(sums[3] == 0)
    rows, columns = blocks.at(_cell_centres()[empty] @ rotation.T)
    sums[:, empty] = blocks.flux_and_solid_angle()[rows, columns].T
    return np.asarray((sums[:3] / sums[3]).T)
