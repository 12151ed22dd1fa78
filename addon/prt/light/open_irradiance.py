"""The irradiance of a surface that sees the whole sky above it, as a table over normals.

The map is gathered into clusters, patches of a few degrees, each the vector of its flux times
direction: what a cluster above the horizon gives is the vector's component along the normal, exact
for all that lies on one side.  The brightest small patches, whose horizons the table would blur,
stay out of it and are added normal by normal.
"""

import numpy as np
import numpy.typing as npt

from .map_sampler import LUMINANCE, Blocks

Float = npt.NDArray[np.float64]
Index = npt.NDArray[np.int64]

PATCHES = 512  # across a disc: 0.3 degrees
CLUSTER = 8  # patches along a side of a cluster
BRIGHT = 256
STEPS = 96  # of the table across a disc and its margin
MARGIN = 1.1  # radius of the table's discs: a cell on the horizon has all of its corners
PLACES = 512  # rows of places that patches are summed from
NORMALS_AT_ONCE = 64


def on_discs(directions: Float) -> tuple[Float, npt.NDArray[np.bool_]]:
    """Lambert's equal-area projection (..., 2) of the upper and the lower half of the directions
    (..., 3) onto two discs of radius 1, and which are on the lower one."""
    z = directions[..., 2]
    return directions[..., :2] / np.sqrt(1 + np.abs(z))[..., None], z < 0


class OpenIrradiance:
    """Irradiance (..., 3) of normals (..., 3) in the map's axes, under the light of ``blocks``."""

    def __init__(self, blocks: Blocks) -> None:
        patches = _patches(blocks)
        vectors = np.tensordot(LUMINANCE, patches, (0, 1))
        size = np.sqrt(np.square(vectors).sum(axis=0))
        bright = np.sort(np.argpartition(size, -BRIGHT)[-BRIGHT:])
        self._towards = vectors[:, bright] / np.where(size > 0, size, 1)[bright]
        self._flux = np.sqrt(np.square(patches[:, :, bright]).sum(axis=0)).T
        patches[:, :, bright] = 0
        self._table = _table(_clusters(patches))

    def __call__(self, normals: Float) -> Float:
        """Unit ``normals`` (P, 3); every row for itself, so its bits don't depend on the others."""
        place, lower = on_discs(normals)
        place = (place / MARGIN + 1) * (0.5 * STEPS)
        cell = np.clip(place.astype(np.int64), 0, STEPS - 1)
        within = place - cell
        total = np.zeros((len(normals), 3))
        for i in (0, 1):
            for j in (0, 1):
                u = within[:, 0] if i else 1 - within[:, 0]
                v = within[:, 1] if j else 1 - within[:, 1]
                corner = self._table[lower.astype(np.int64), cell[:, 0] + i, cell[:, 1] + j]
                total += (u * v)[:, None] * corner
        x, y, z = self._towards
        cosines = normals[:, 0, None] * x + normals[:, 1, None] * y + normals[:, 2, None] * z
        bright = np.matmul(np.maximum(0, cosines)[:, None], self._flux)  # for each its own product
        return np.asarray(total + bright[:, 0])


def _patches(blocks: Blocks) -> Float:
    """Flux times direction (3, 3, 2 PATCHES²), axes by channels, of equal patches of the map."""
    sums = np.zeros((3, 3, 2 * PATCHES * PATCHES))
    for directions, weights in blocks.places(PLACES):
        place, lower = on_discs(directions)
        cell = np.minimum((place + 1) * (0.5 * PATCHES), PATCHES - 1).astype(np.int64)
        found = (lower * PATCHES + cell[:, 0]) * PATCHES + cell[:, 1]
        for axis in range(3):
            for channel in range(3):
                moment = directions[:, axis] * weights[:, channel]
                sums[axis, channel] += np.bincount(found, moment, sums.shape[-1])
    return sums


def _clusters(patches: Float) -> Float:
    """Sums (C, 3, 3) of neighbouring ``patches``, without the empty ones."""
    size = PATCHES // CLUSTER
    joined = patches.reshape(3, 3, 2 * size, CLUSTER, size, CLUSTER).sum(axis=5).sum(axis=3)
    joined = np.moveaxis(joined.reshape(3, 3, -1), -1, 0)
    return np.asarray(joined[joined.any(axis=(1, 2))])


def _table(clusters: Float) -> Float:
    """Irradiance (2, STEPS + 1, STEPS + 1, 3) of ``clusters`` at the table's normals."""
    u = (np.arange(STEPS + 1) / (0.5 * STEPS) - 1) * MARGIN
    x, y = np.repeat(u, len(u)), np.tile(u, len(u))
    z = 1 - x * x - y * y
    rim = np.sqrt(np.maximum(1 + z, 0))
    upper = np.stack([x * rim, y * rim, z], axis=1)
    normals = np.concatenate([upper, upper * [1, 1, -1]]).astype(np.float32)
    unit = max(float(np.abs(clusters).max(initial=0)), np.finfo(np.float64).tiny)
    vectors = (clusters / unit).astype(np.float32)
    towards = np.ascontiguousarray((vectors @ LUMINANCE.astype(np.float32)).T)
    moments = vectors.reshape(-1, 9)
    table = np.empty((len(normals), 3))
    for first in range(0, len(normals), NORMALS_AT_ONCE):
        some = normals[first : first + NORMALS_AT_ONCE]
        above = (some @ towards > 0).astype(np.float32)
        seen = (above @ moments).reshape(-1, 3, 3)
        table[first : first + NORMALS_AT_ONCE] = np.einsum("nc,nck->nk", some, seen)
    table *= unit
    return table.reshape(2, len(u), len(u), 3)
