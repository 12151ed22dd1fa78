"""The directions that no occluder can block, known without a ray.

Seen from a block of neighbouring points nothing rises above some elevation over their tangent
planes, and a direction above that reaches the sky.  The set of directions is ordered by its angle
to the normal, so those are its first ones, and only the rest is traced.

The triangles are gathered into clusters, each bounded by a short cylinder about its mean normal:
flat ground then stays flat, however it is turned, and does not rise above itself.  Every bound is
conservative.
"""

from dataclasses import dataclass
from math import pi

import numpy as np
import numpy.typing as npt

Float = npt.NDArray[np.float64]
Index = npt.NDArray[np.int64]

CLUSTERS = 1024
CELLS = 20  # along each axis: a cluster lies in one cell
CHUNK = 1 << 18  # triangles
WORTH = 0.05  # of the rays have to be saved by a sample of the blocks
SAMPLE, BLOCK = 64, 64  # blocks, and their points


@dataclass(frozen=True)
class Clusters:
    """Bounds of C groups of triangles: ``centres`` and unit ``axes`` (C, 3); the extents ``low``
    and ``high`` (C,) along the axis and ``across`` (C,) about it, ``radius`` (C,) about the centre.
    """

    centres: Float
    axes: Float
    low: Float
    high: Float
    across: Float
    radius: Float

    @classmethod
    def of(cls, vertices: npt.ArrayLike, triangles: npt.ArrayLike) -> "Clusters":
        """Clusters of ``triangles`` (F, 3) of ``vertices`` (V, 3)."""
        places, corners = np.asarray(vertices), np.asarray(triangles)
        keys = _keys(places, corners)
        order = np.argsort(keys, kind="stable")  # a radix sort of 16 bits
        starts = _starts(keys[order], -(-len(corners) // CLUSTERS))
        cuts = starts[np.searchsorted(starts, np.arange(0, len(corners), CHUNK))]
        parts = []
        for low, high in zip(cuts, [*cuts[1:], len(corners)], strict=True):
            inside = starts[(starts >= low) & (starts < high)] - low
            its_corners = places[corners[order[low:high]]].astype(np.float64)
            parts.append(_bounds(its_corners, inside))
        return cls(*(np.concatenate(column) for column in zip(*parts, strict=True)))


def _keys(
    vertices: npt.NDArray[np.floating], triangles: npt.NDArray[np.int32]
) -> npt.NDArray[np.uint16]:
    """For each triangle the cell of a grid that its first corner lies in and the side that it
    faces, so that what stands on a floor is not gathered with it."""
    low = vertices.min(axis=0)
    extent = max(float((vertices.max(axis=0) - low).max()), 1e-30)
    keys = np.empty(len(triangles), np.uint16)
    for start in range(0, len(triangles), CHUNK):
        corners = vertices[triangles[start : start + CHUNK]]
        normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        cell = ((corners[:, 0] - low) * (CELLS / extent)).clip(0, CELLS - 1).astype(np.int64)
        places = (cell[:, 0] * CELLS + cell[:, 1]) * CELLS + cell[:, 2]
        keys[start : start + CHUNK] = places * 3 + np.abs(normals).argmax(axis=1)
    return keys


def _starts(keys: npt.NDArray[np.uint16], size: int) -> Index:
    """Where clusters start among triangles that are sorted by ``keys``: at every new key, and
    after ``size`` triangles."""
    new = np.ones(len(keys), bool)
    new[1:] = keys[1:] != keys[:-1]
    first = np.flatnonzero(new)
    place = np.arange(len(keys)) - np.repeat(first, np.diff(np.append(first, len(keys))))
    return np.flatnonzero(place % size == 0)


def _bounds(corners: Float, starts: Index) -> tuple[Float, ...]:
    """The fields of Clusters of ``corners`` (F, 3, 3), in groups that begin at ``starts``."""
    counts = np.diff(np.append(starts, len(corners)))
    cross = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    axes = np.add.reduceat(cross, starts)
    length = np.linalg.norm(axes, axis=1, keepdims=True)
    axes = np.where(length > 0, axes / np.where(length > 0, length, 1), [0.0, 0.0, 1.0])
    low = np.minimum.reduceat(corners.min(axis=1), starts)
    high = np.maximum.reduceat(corners.max(axis=1), starts)
    centres = 0.5 * (low + high)
    from_centre = corners - np.repeat(centres, counts, axis=0)[:, None]
    along = np.einsum("fkc,fc->fk", from_centre, np.repeat(axes, counts, axis=0))
    squared = np.einsum("fkc,fkc->fk", from_centre, from_centre)
    across = np.maximum.reduceat((squared - along**2).max(axis=1), starts)
    return (
        centres,
        axes,
        np.minimum.reduceat(along.min(axis=1), starts),
        np.maximum.reduceat(along.max(axis=1), starts),
        np.sqrt(np.maximum(across, 0)),
        np.sqrt(np.maximum.reduceat(squared.max(axis=1), starts)),
    )


class Horizon:
    """How high the occluders rise above the tangent planes of blocks of points."""

    def __init__(self, clusters: Clusters) -> None:
        self._clusters = clusters

    def open_share(self, origins: npt.ArrayLike, normals: npt.ArrayLike) -> Float:
        """For blocks of points (B, K, 3) with unit normals: sin² of the angle (B,) to the normal
        within which every direction of every point of the block reaches the sky.

        It is the share of a cosine-distributed set that needs no ray.
        """
        places, its_normals = np.asarray(origins, np.float64), np.asarray(normals, np.float64)
        its_normals = its_normals / np.linalg.norm(its_normals, axis=2, keepdims=True)
        axis = its_normals.sum(axis=1)
        axis /= np.maximum(np.linalg.norm(axis, axis=1, keepdims=True), 1e-30)
        nearest = np.einsum("bkc,bc->bk", its_normals, axis).min(axis=1)
        tilt = np.arccos(np.clip(nearest, -1, 1))
        tilt[nearest > 1 - 1e-12] = 0
        elevation = np.arctan(self._steepest(places, axis)) + tilt
        return np.asarray(np.cos(np.minimum(elevation, 0.5 * pi)) ** 2)

    def _steepest(self, places: Float, axis: Float) -> Float:
        """The tangent (B,) of the largest elevation of any cluster over planes across ``axis``
        (B, 3) through points (B, K, 3); inf where one is too near to tell."""
        c = self._clusters
        middle = 0.5 * (places.min(axis=1) + places.max(axis=1))
        offset = places - middle[:, None]
        along = np.einsum("bkc,bc->bk", offset, axis)
        squared = np.einsum("bkc,bkc->bk", offset, offset)
        lowest = along.min(axis=1)
        width = np.sqrt(np.maximum(squared - along**2, 0).max(axis=1))
        away = c.centres[:, None] - middle
        above = np.einsum("nbc,bc->nb", away, axis)
        aside = np.sqrt(np.maximum(np.einsum("nbc,nbc->nb", away, away) - above**2, 0))
        turn = c.axes @ axis.T
        reach = np.maximum(c.high[:, None] * turn, c.low[:, None] * turn)
        reach += c.across[:, None] * np.sqrt(np.maximum(1 - turn**2, 0))
        height = above + reach - lowest
        gap = aside - c.radius[:, None] - width
        steep = np.where(gap > 0, height / np.where(gap > 0, gap, 1), np.inf)
        return np.asarray(np.where(height > 0, steep, 0).max(axis=0))


def horizon(
    vertices: npt.ArrayLike,
    triangles: npt.ArrayLike,
    origins: npt.NDArray[np.float32],
    normals: npt.NDArray[np.float32],
) -> Horizon | None:
    """The horizon of points (P, 3); None where a sample of them says that it would hardly save a
    ray."""
    if not len(np.asarray(triangles)):
        return None
    found = Horizon(Clusters.of(vertices, triangles))
    starts = np.linspace(0, max(0, len(origins) - BLOCK), SAMPLE).astype(np.int64)
    rows = np.minimum(np.unique(starts)[:, None] + np.arange(BLOCK), len(origins) - 1)
    saved = found.open_share(origins[rows], normals[rows]).mean()
    return found if saved > WORTH else None
