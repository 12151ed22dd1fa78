"""Flat grids as the few triangles that cover the same polygon, for rays that only ask whether
anything is there.

A floor is divided finely because values are baked to its vertices; Embree is done with it sooner
where it is not.  Only what lies in a plane across an axis is taken, to the last bit: there a large
triangle's plane is as exact as a small one's.
"""

from dataclasses import dataclass
from math import pi

import numpy as np
import numpy.typing as npt

from ..slices import slices

Float = npt.NDArray[np.float64]
Index = npt.NDArray[np.int64]
Bools = npt.NDArray[np.bool_]
Vertices = npt.NDArray[np.float32]
Triangles = npt.NDArray[np.int32]

FEWEST, SHARE = 512, 1 / 64  # triangles, and of all triangles, that a grid has to be worth it
TURNS = 16  # directions in which a polygon's corners are sought
LINE = 2.0**-21  # of a polygon's extent: so near its sides the border lies
AREA = 1e-3  # of the polygon's: the areas add up to it but for this
PIECE = 1 << 14  # triangles that are looked at together
CROSSING = 2  # vertices of other things at a side, where these cross it: more may lie along it


@dataclass(frozen=True)
class Parts:
    """``triangles`` (F, 3) of ``vertices`` (V, 3) of several things: those of part k are from
    ``starts[k]`` up to the next, (O + 1,)."""

    vertices: Vertices
    triangles: Triangles
    starts: Index

    @classmethod
    def of(
        cls, vertices: npt.ArrayLike, triangles: npt.ArrayLike, starts: npt.ArrayLike
    ) -> "Parts":
        """From arrays of any type."""
        faces = np.asarray(triangles, np.int32)
        return cls(np.asarray(vertices, np.float32), faces, np.asarray(starts, np.int64))


def fewer(parts: Parts) -> Parts:
    """As many parts that cover the same.

    A part's flat grid is replaced where it covers a convex polygon once, all of it facing one way,
    and nothing else joins on to its sides, which would leave a slit between their edges.
    """
    vertices, triangles = parts.vertices, parts.triangles
    kept, flats, its_part = np.ones(len(triangles), bool), list[Index](), list[Index]()
    uses = np.bincount(triangles.reshape(-1), minlength=len(vertices))
    for axis in range(3):
        for rows in _planes(vertices[:, axis], triangles, parts.starts):
            corners = _replaced(vertices, triangles[rows], axis, uses)
            if len(corners):
                kept[rows] = False
                flats.append(_fan(corners))
                part = np.searchsorted(parts.starts, rows[0], side="right") - 1
                its_part.append(np.full(len(flats[-1]), part))
    if not flats:
        return parts
    part_of = np.concatenate(its_part)
    starts = np.insert(np.cumsum(kept), 0, 0)[parts.starts]
    found = np.insert(triangles[kept], starts[part_of + 1], np.concatenate(flats), axis=0)
    starts[1:] += np.cumsum(np.bincount(part_of, minlength=len(starts) - 1))
    used = np.zeros(len(vertices), bool)
    used[found] = True
    return Parts(vertices[used], (np.cumsum(used) - 1)[found].astype(np.int32), starts)


def _planes(heights: Vertices, triangles: Triangles, part_starts: Index) -> list[Index]:
    """Rows of the triangles of one part that lie at one of the ``heights`` (V,), many together."""
    first = heights[triangles[:, 0]]
    rows = np.flatnonzero(first == heights[triangles[:, 1]])
    rows = rows[first[rows] == heights[triangles[rows, 2]]]
    fewest = max(FEWEST, SHARE * len(triangles))
    part = np.searchsorted(part_starts, rows, side="right")
    order = np.lexsort((first[rows], part))
    rows, part = rows[order], part[order]
    cuts = np.flatnonzero((np.diff(first[rows]) != 0) | (np.diff(part) != 0)) + 1
    return [plane for plane in np.split(rows, cuts) if len(plane) >= fewest]


def _replaced(vertices: Vertices, triangles: Triangles, axis: int, uses: Index) -> Index:
    """The corners (K,), run through as the triangles are, of the polygon that can stand for
    ``triangles`` in a plane across ``axis``, where all triangles make so many ``uses`` (V,) of the
    vertices; none where none can."""
    across = [k for k in range(3) if k != axis]
    low = int(triangles.min())
    its_uses = np.bincount((triangles - low).reshape(-1))
    own = slice(low, low + len(its_uses))
    places = vertices[own][:, across].astype(np.float64)
    corners = _polygon(places, triangles - low, its_uses > 0)
    if not len(corners):
        return corners
    shared = (its_uses > 0) & (its_uses < uses[own])
    shared[corners] = False
    near = _near(places[corners])
    beside = np.abs(vertices[:, axis] - vertices[triangles[0, 0], axis]) < near
    beside[own] &= its_uses == 0
    others = vertices[beside][:, across].astype(np.float64)
    depths = _depths(others, places[corners])
    joined = ((depths < near) & (depths > -near).all(axis=0)).sum(axis=1)
    if shared.any() or (joined > CROSSING).any():
        return corners[:0]
    turned = _areas(places, triangles[:1] - low)[0] < 0
    return low + (corners[::-1] if turned else corners)


def _polygon(places: Float, triangles: Triangles, used: Bools) -> Index:
    """The corners (K,), counter-clockwise, of the convex polygon that ``triangles`` cover once,
    whose vertices are the ``used`` (V,) of ``places`` (V, 2); none where they do not.

    Where all edges off its sides are run through as often one way as the other, every place inside
    is covered equally often, and the areas tell how often.
    """
    none = np.empty(0, np.int64)
    angles = 0.1 + np.arange(TURNS) * (2 * pi / TURNS)  # along no side of an upright grid
    its = np.flatnonzero(used)
    towards = np.stack([np.cos(angles), np.sin(angles)], axis=1)
    farthest = its[(towards @ places[its].T).argmax(axis=1)]
    corners: Index = farthest[farthest != np.roll(farthest, 1)]
    if len(corners) < 3:
        return none
    areas, whole = _areas(places, triangles), _areas(places, _fan(corners)).sum()
    faces_one_way = (areas > 0).all() or (areas < 0).all()
    if not faces_one_way or abs(abs(areas.sum()) - whole) > AREA * whole:
        return none
    on_sides = _depths(places, places[corners]) < _near(places[corners])
    rows = np.flatnonzero(on_sides.any(axis=0)[triangles].sum(axis=1) > 1)
    inside = np.ones(triangles.shape, bool)
    for on_side in on_sides[:, triangles[rows]]:
        inside[rows] &= ~(on_side & np.roll(on_side, -1, axis=1))
    return corners if _closed(triangles, inside, len(places)) else none


def _areas(places: Float, triangles: npt.NDArray[np.integer]) -> Float:
    """Twice the signed areas (F,)."""
    columns, areas = np.ascontiguousarray(places.T), np.empty(len(triangles))
    for part in slices(len(triangles), PIECE):
        x, y = columns.take(triangles[part].T, axis=1)
        areas[part] = (x[1] - x[0]) * (y[2] - y[0]) - (y[1] - y[0]) * (x[2] - x[0])
    return areas


def _near(corners: Float) -> float:
    """How far from a side of the polygon of ``corners`` (K, 2) is at it."""
    return LINE * float(np.ptp(corners, axis=0).max())


def _depths(places: Float, corners: Float) -> Float:
    """How far ``places`` (V, 2) lie inside of each side (K, V) of the polygon of ``corners``
    (K, 2)."""
    along = np.roll(corners, -1, axis=0) - corners
    along /= np.linalg.norm(along, axis=1, keepdims=True)
    return np.stack(
        [
            (places[:, 1] - y) * across - (places[:, 0] - x) * up
            for (x, y), (across, up) in zip(corners, along, strict=True)
        ]
    )


def _closed(triangles: Triangles, chosen: Bools, count: int) -> bool:
    """Whether the ``chosen`` edges (F, 3), of so many vertices, are each run through as often one
    way as the other.

    With random numbers x and y of the vertices an edge from i to j counts as x_i y_j - x_j y_i,
    which turns its sign with the way; the sum, modulo 2^64, is a form in all x and y that vanishes
    by chance alone unless the edges do one by one."""
    x, y = np.random.default_rng(0).integers(1 << 64, size=(2, count), dtype=np.uint64)
    sums = []
    for part in slices(len(triangles), PIECE):
        its_x, its_y = x.take(triangles[part].T), y.take(triangles[part].T)
        for i, mine in enumerate(chosen[part].T):
            j = (i + 1) % 3
            sums.append(((its_x[i] * its_y[j] - its_x[j] * its_y[i]) * mine).sum(dtype=np.uint64))
    return bool(np.array(sums, np.uint64).sum() == 0)


def _fan(corners: Index) -> Index:
    """Triangles (K - 2, 3) of a convex polygon."""
    first = np.full(len(corners) - 2, corners[0])
    return np.asarray(np.stack([first, corners[1:-1], corners[2:]], axis=1), np.int64)
