"""The directions that no occluder can block, known without a ray.

Seen from a block of neighbouring points nothing rises above some elevation over their tangent
planes, and a direction above that reaches the sky.  The set of directions is ordered by its angle
to the normal, so those are its first ones, and only the rest is traced.

The triangles are gathered into clusters, each bounded by a short cylinder about its mean normal:
flat ground then stays flat, however it is turned, and does not rise above itself.  Every bound is
conservative.
"""

from dataclasses import dataclass
from functools import cached_property
from math import pi

import numpy as np
import numpy.typing as npt

from ..job import Receiver
from ..surface.convex import is_convex
from ..surface.points import Points

Float = npt.NDArray[np.float64]
Index = npt.NDArray[np.int64]

CLUSTERS = 1024
CELLS = 20  # along each axis: a cluster lies in one cell
CHUNK = 1 << 18  # triangles
WORTH = 0.05  # of the rays have to be saved by a sample of the blocks
SAMPLE, BLOCK = 64, 64  # blocks, and their points
FLAT = 1e-4
REACH_BLOCKS = 256
MIXED = 0.3  # radians between the normals of a block: its points are then looked at one by one


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
    def of(
        cls, vertices: npt.ArrayLike, triangles: npt.ArrayLike, part_starts: npt.ArrayLike
    ) -> "Clusters":
        """Clusters of ``triangles`` (F, 3) of ``vertices`` (V, 3); part k of them is from
        ``part_starts[k]`` up to the next."""
        places, corners = np.asarray(vertices), np.asarray(triangles)
        keys = _keys(places, corners)
        order = np.argsort(keys, kind="stable")  # a radix sort of 16 bits
        part_of = np.searchsorted(np.asarray(part_starts), order, side="right") - 1
        starts = _starts(keys[order], part_of, -(-len(corners) // CLUSTERS))
        cuts = starts[np.searchsorted(starts, np.arange(0, len(corners), CHUNK))]
        parts = []
        for low, high in zip(cuts, [*cuts[1:], len(corners)], strict=True):
            inside = starts[(starts >= low) & (starts < high)] - low
            its_corners = places[corners[order[low:high]]].astype(np.float64)
            parts.append(_bounds(its_corners, inside))
        columns = (np.concatenate(column) for column in zip(*parts, strict=True))
        centres, axes, low, high, across, radius = columns
        return cls(centres, axes, low, high, across, radius, part_of[starts])

    def without(self, parts: npt.ArrayLike) -> "Clusters":
        """The clusters of all other parts."""
        kept = ~np.isin(self.parts, parts)
        return Clusters(*(values[kept] for values in vars(self).values()))


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


def _starts(keys: npt.NDArray[np.uint16], part_of: Index, size: int) -> Index:
    """Where clusters start among triangles that are sorted by ``keys``: at every new key or part,
    and after ``size`` triangles."""
    new = np.ones(len(keys), bool)
    new[1:] = (keys[1:] != keys[:-1]) | (part_of[1:] != part_of[:-1])
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
        tilt = np.arccos(np.clip(np.einsum("bkc,bc->bk", its_normals, axis).min(axis=1), -1, 1))
        share = np.cos(np.minimum(self._elevation(places, axis, tilt), 0.5 * pi)) ** 2
        for block in np.flatnonzero(tilt > MIXED) if places.shape[1] > 1 else ():
            alone = self.open_share(places[block, :, None], its_normals[block, :, None])
            share[block] = alone.min()
        return np.asarray(share)

    def _elevation(self, places: Float, axis: Float, tilt: Float) -> Float:
        """The largest angle (B,) at which any cluster rises over the tangent planes of points
        (B, K, 3) whose normals are within ``tilt`` of ``axis`` (B, 3)."""
        c = self._clusters
        middle = 0.5 * (places.min(axis=1) + places.max(axis=1))
        offset = places - middle[:, None]
        along = np.einsum("bkc,bc->bk", offset, axis)
        squared = np.einsum("bkc,bkc->bk", offset, offset).max(axis=1)
        away = c.centres[:, None] - middle
        above = np.einsum("nbc,bc->nb", away, axis)
        distance = np.sqrt(np.einsum("nbc,nbc->nb", away, away))
        turn = c.axes @ axis.T
        reach = np.maximum(c.high[:, None] * turn, c.low[:, None] * turn)
        reach += c.across[:, None] * np.sqrt(np.maximum(1 - turn**2, 0))
        height = above + reach - along.min(axis=1)
        spread = c.radius[:, None] + np.sqrt(squared)
        gap = np.sqrt(np.maximum(distance**2 - above**2, 0)) - spread
        steep = np.where(gap > 0, height / np.where(gap > 0, gap, 1), np.inf)
        tangent = np.where(height > 0, steep, 0).max(axis=0, initial=0)
        rises = height + 2 * np.sin(0.5 * tilt) * (distance + spread) > 0
        return np.asarray(np.where(rises.any(axis=0), np.arctan(tangent) + tilt, 0))


class Surroundings:
    """All occluders: vertices (V, 3), triangles (F, 3), and where each of them starts, (O + 1,)."""

    def __init__(
        self, vertices: npt.ArrayLike, triangles: npt.ArrayLike, part_starts: npt.ArrayLike
    ) -> None:
        self._vertices, self._triangles = np.asarray(vertices), np.asarray(triangles)
        self._starts = np.asarray(part_starts)

    @cached_property
    def _clusters(self) -> Clusters:
        return Clusters.of(self._vertices, self._triangles, self._starts)

    @cached_property
    def _boxes(self) -> Float:
        """Lowest and highest corner (O, 6) of every part."""
        places = self._vertices[self._triangles]
        filled = np.flatnonzero(np.diff(self._starts) > 0)
        boxes = np.full((len(self._starts) - 1, 6), np.nan)
        boxes[filled, :3] = np.minimum.reduceat(places.min(axis=1), self._starts[filled])
        boxes[filled, 3:] = np.maximum.reduceat(places.max(axis=1), self._starts[filled])
        return boxes

    def horizon(self, receiver: Receiver, points: Points) -> Horizon | None:
        """What rises above the tangent planes of ``points`` of ``receiver``; None where a look at
        some of them says that knowing it would hardly save a ray.

        Only a flat surface or a convex body does not stand in its own light everywhere.
        """
        if not len(self._triangles):
            return None
        rows = _sample(points)
        convex = is_convex(receiver)
        if not convex and _flat_share(points, rows) < WORTH:
            return None
        clusters = self._clusters
        if convex:
            clusters = clusters.without(self._parts_like(receiver))
        found = Horizon(clusters)
        saved = found.open_share(points.origins[rows], points.normals[rows]).mean()
        return found if saved > WORTH else None

    def reachable(self, points: Points) -> Index:
        """The parts, ascending, that rise above the tangent plane of any of ``points``: nothing
        else can change what they see."""
        size = max(BLOCK, -(-len(points.origins) // REACH_BLOCKS))
        starts = np.arange(0, len(points.origins), size)
        found = np.zeros(len(self._boxes), bool)
        for start in starts:
            part = slice(start, start + size)
            normals = points.normals[part].astype(np.float64)
            axis = normals.mean(axis=0)
            axis /= max(float(np.linalg.norm(axis)), 1e-30)
            lowest = (points.origins[part].astype(np.float64) @ axis).min()
            middle = 0.5 * (self._boxes[:, :3] + self._boxes[:, 3:])
            half = 0.5 * (self._boxes[:, 3:] - self._boxes[:, :3])
            height = middle @ axis + half @ np.abs(axis) - lowest
            nearest = float((normals @ axis).min())
            away = np.linalg.norm(middle - points.origins[start], axis=1)
            away += np.linalg.norm(half, axis=1) + np.ptp(points.origins[part], axis=0).max() * 2
            chord = np.sqrt(max(0.0, 2 - 2 * nearest))
            found |= height + chord * away > 0
        return np.asarray(np.flatnonzero(found))

    def _parts_like(self, receiver: Receiver) -> Index:
        """The parts that are ``receiver`` itself: as large, as many triangles, at its place."""
        places = np.asarray(receiver.vertices)[receiver.triangles].reshape(-1, 3)
        box = np.concatenate([places.min(axis=0), places.max(axis=0)])
        same_size = np.diff(self._starts) == len(receiver.triangles)
        found: Index = np.flatnonzero(same_size & (self._boxes == box).all(axis=1))
        return found


def _sample(points: Points) -> Index:
    """Some blocks (B, K) of neighbouring points."""
    count = len(points.origins)
    starts = np.linspace(0, max(0, count - BLOCK), SAMPLE).astype(np.int64)
    return np.asarray(np.minimum(np.unique(starts)[:, None] + np.arange(BLOCK), count - 1))


def _flat_share(points: Points, rows: Index) -> float:
    """The share of the blocks whose points lie in one plane across their normals."""
    places = points.origins[rows].astype(np.float64)
    normals = points.normals[rows].astype(np.float64)
    offset = places - places[:, :1]
    height = np.abs(np.einsum("bkc,bc->bk", offset, normals[:, 0])).max(axis=1)
    width = np.abs(offset).max(axis=(1, 2))
    turned = np.abs(normals - normals[:, :1]).max(axis=(1, 2))
    return float(((height <= FLAT * width) & (turned <= FLAT)).mean())
