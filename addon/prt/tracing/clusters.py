"""Triangles in clusters, each bounded by a short cylinder about its mean normal: flat ground then
stays flat, however it is turned, and does not rise above itself.
"""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from ..surface.points import interleaved
from .flats import Parts

Float = npt.NDArray[np.float64]
Index = npt.NDArray[np.int64]

FEWEST = 128  # clusters, however few cells the triangles lie in
DEEPEST = 6  # times that a cube is cut in eight
CELLS = 22  # along an axis, that a triangle reaches across at most one of, where it is cut
FLAT = 1e-6  # sin² of the angle between two triangles of one plane
CHUNK = 1 << 18  # triangles
PIECES = 4096  # of triangles larger than a cell


@dataclass(frozen=True)
class Clusters:
    """Bounds of C groups of triangles: ``centres`` and unit ``axes`` (C, 3); the extents ``low``
    and ``high`` (C,) along the axis and ``across`` (C,) about it, ``radius`` (C,) about the centre;
    and ``parts`` (C,), the occluder that each is of."""

    centres: Float
    axes: Float
    low: Float
    high: Float
    across: Float
    radius: Float
    parts: Index

    @classmethod
    def of(cls, parts: Parts, most: int) -> "Clusters":
        """Clusters of the triangles of ``parts``, in about ``most`` cells and sides."""
        places, corners, part_of = _cut(parts)
        keys = _keys(places, corners)
        keys >>= _needless(keys, most)
        order = np.argsort(keys, kind="stable")
        part_of = part_of[order]
        starts = _starts(keys[order], part_of, -(-len(corners) // FEWEST))
        cuts = starts[np.searchsorted(starts, np.arange(0, len(corners), CHUNK))]
        bounds = []
        for low, high in zip(cuts, [*cuts[1:], len(corners)], strict=True):
            inside = starts[(starts >= low) & (starts < high)] - low
            its_corners = places[corners[order[low:high]]].astype(np.float64)
            bounds.append(_bounds(its_corners, inside))
        columns = (np.concatenate(column) for column in zip(*bounds, strict=True))
        centres, axes, low, high, across, radius = columns
        return cls(centres, axes, low, high, across, radius, part_of[starts])

    def __getitem__(self, kept: npt.NDArray[np.bool_]) -> "Clusters":
        return Clusters(*(values[kept] for values in vars(self).values()))

    def without(self, parts: npt.ArrayLike) -> "Clusters":
        """The clusters of all other parts."""
        return self[~np.isin(self.parts, parts)]


def lowest(corners: npt.NDArray[np.floating]) -> npt.NDArray[np.floating]:
    """The least (F, ...) of the three corners of triangles (F, 3, ...): numpy is slow over a short
    axis."""
    return np.asarray(np.minimum(np.minimum(corners[:, 0], corners[:, 1]), corners[:, 2]))


def highest(corners: npt.NDArray[np.floating]) -> npt.NDArray[np.floating]:
    """The largest (F, ...) of the three corners of triangles (F, 3, ...)."""
    return np.asarray(np.maximum(np.maximum(corners[:, 0], corners[:, 1]), corners[:, 2]))


def _cut(parts: Parts) -> tuple[npt.NDArray[np.floating], npt.NDArray[np.int32], Index]:
    """Vertices (V', 3), triangles (F', 3) and the part (F',) of each, those that reach across more
    than a cell cut into four, and these again, as long as that makes no more than PIECES."""
    vertices, triangles = parts.vertices, parts.triangles
    part_of = np.repeat(np.arange(len(parts.starts) - 1), np.diff(parts.starts))
    cell = _extent(vertices) / CELLS
    large = np.zeros(len(triangles), bool)
    for start in range(0, len(triangles), CHUNK):
        its = slice(start, start + CHUNK)
        large[its] = _reach(vertices[triangles[its]]) > cell
    corners, its_part = vertices[triangles[large]].astype(np.float64), part_of[large]
    while True:
        cut = _reach(corners) > cell
        if not cut.any() or len(corners) + 3 * cut.sum() > PIECES:
            break
        a, b, c = corners[cut].transpose(1, 0, 2)
        ab, bc, ca = 0.5 * (a + b), 0.5 * (b + c), 0.5 * (c + a)
        quarters = (a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca)
        corners = np.concatenate([corners[~cut], *(np.stack(q, axis=1) for q in quarters)])
        its_part = np.concatenate([its_part[~cut], *[its_part[cut]] * 4])
    pieces = len(vertices) + np.arange(3 * len(corners), dtype=np.int32).reshape(-1, 3)
    return (
        np.concatenate([vertices, corners.reshape(-1, 3)]) if len(corners) else vertices,
        np.concatenate([triangles[~large], pieces]),
        np.concatenate([part_of[~large], its_part]),
    )


def _extent(vertices: npt.NDArray[np.floating]) -> float:
    """Of the largest side of the box about ``vertices`` (V, 3)."""
    return max(float(np.ptp(vertices, axis=0).max()), 1e-30)


def _reach(corners: npt.NDArray[np.floating]) -> npt.NDArray[np.floating]:
    """How far triangles (F, 3, 3) reach along the axis where they do so farthest."""
    return np.asarray((highest(corners) - lowest(corners)).max(axis=1))


def _keys(
    vertices: npt.NDArray[np.floating], triangles: npt.NDArray[np.int32]
) -> npt.NDArray[np.uint32]:
    """For each triangle the side that it faces and whether the one after or before it faces just
    there too, so that what stands on a floor is not gathered with it; and in the lower bits, three
    by three, the cell that its first corner lies in, of a cube that is cut in eight, each of these
    too, and so on."""
    low, extent = vertices.min(axis=0), _extent(vertices)
    steps = (1 << DEEPEST) / extent
    keys = np.empty(len(triangles), np.uint32)
    for start in range(0, len(triangles), CHUNK):
        corners = vertices[triangles[start : start + CHUNK]]
        normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        cell = ((corners[:, 0] - low) * steps).clip(0, (1 << DEEPEST) - 1).astype(np.int64)
        places = interleaved(cell.T, DEEPEST).astype(np.uint32)
        sides = np.abs(normals).argmax(axis=1) * 2 + _flat(normals)
        keys[start : start + CHUNK] = sides.astype(np.uint32) << np.uint32(3 * DEEPEST) | places
    return keys


def _needless(keys: npt.NDArray[np.uint32], most: int) -> int:
    """How many of the last bits of ``keys`` (F,) to do without, so that there are no more than
    ``most`` different ones, or all cells are one."""
    different = np.flatnonzero(np.bincount(keys))
    for depth in range(DEEPEST):
        if np.count_nonzero(np.diff(different >> 3 * depth)) < most:
            return 3 * depth
    return 3 * DEEPEST


def _starts(keys: npt.NDArray[np.uint32], part_of: Index, size: int) -> Index:
    """Where clusters start among triangles that are sorted by ``keys``: at every new key or part,
    and after ``size`` triangles."""
    new = np.ones(len(keys), bool)
    new[1:] = (keys[1:] != keys[:-1]) | (part_of[1:] != part_of[:-1])
    first = np.flatnonzero(new)
    place = np.arange(len(keys)) - np.repeat(first, np.diff(np.append(first, len(keys))))
    return np.flatnonzero(place % size == 0)


def _flat(normals: npt.NDArray[np.floating]) -> npt.NDArray[np.bool_]:
    """Which of neighbouring triangles with ``normals`` (F, 3) face where their neighbour does."""
    square = np.einsum("fc,fc->f", normals, normals)
    alike = np.einsum("fc,fc->f", normals[1:], normals[:-1])
    alike = alike**2 >= (1 - FLAT) * square[1:] * square[:-1]
    return np.asarray(np.append(alike, False) | np.insert(alike, 0, False))


def _bounds(corners: Float, starts: Index) -> tuple[Float, ...]:
    """The fields of Clusters of ``corners`` (F, 3, 3), in groups that begin at ``starts``."""
    counts = np.diff(np.append(starts, len(corners)))
    cross = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    axes = np.add.reduceat(cross, starts)
    length = np.linalg.norm(axes, axis=1, keepdims=True)
    axes = np.where(length > 0, axes / np.where(length > 0, length, 1), [0.0, 0.0, 1.0])
    low = np.minimum.reduceat(lowest(corners), starts)
    high = np.maximum.reduceat(highest(corners), starts)
    centres = 0.5 * (low + high)
    from_centre = corners - np.repeat(centres, counts, axis=0)[:, None]
    along = np.einsum("fkc,fc->fk", from_centre, np.repeat(axes, counts, axis=0))
    squared = np.einsum("fkc,fkc->fk", from_centre, from_centre)
    across = np.maximum.reduceat(highest(squared - along**2), starts)
    return (
        centres,
        axes,
        np.minimum.reduceat(lowest(along), starts),
        np.maximum.reduceat(highest(along), starts),
        np.sqrt(np.maximum(across, 0)),
        np.sqrt(np.maximum.reduceat(highest(squared), starts)),
    )
