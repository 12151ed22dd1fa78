"""Where on the triangles of a scene a ray ends, as one number.

A triangle that is baked has its three corners for entries: a ray that hits it ends at one of them,
drawn with the probability of its barycentric coordinate, so that on average it finds what is
interpolated there.  Any other triangle is cut into ``level²`` cells, about as large everywhere, and
a ray ends in the cell that it hits.  Entry ``e + count`` is the back of what entry ``e`` is the
front of.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import numpy.typing as npt

from ..job import Job, Receiver
from ..mixing import mixed
from ..surface.points import Points, element_triangles
from ..tracing.rays import Met

Index = npt.NDArray[np.int64]
Entry = npt.NDArray[np.int32]
Array = npt.NDArray[np.float32]
Float = npt.NDArray[np.float64]
Keys = npt.NDArray[np.uint64]

CELL = 1 / 24  # of the receivers' extent: the side of a cell
MOST_ROWS = 128  # of cells in one triangle
TO_CORNER = 0.75 / 3 * np.array([[-1, -1], [2, -1], [-1, 2]])  # of a lower cell's side
CORNER = 2 / 3  # the place that stands for a corner's share of a triangle: its own coordinate


@dataclass(frozen=True)
class Entries:
    """``first`` (F,) is the first entry of each triangle, ``levels`` (F,) the rows of its cells, 0
    where its corners are entries, and ``points`` (count,) the points that front entries are: points
    of all receivers in a row, -1 for the cells, which are at most about ``side`` wide."""

    first: Entry
    levels: Entry
    points: Entry
    count: int
    side: float = 1.0

    @classmethod
    def of(cls, job: Job, points: Sequence[Points]) -> "Entries":
        """The entries of the occluders of ``job``, whose receivers have ``points``; without any
        of these every triangle is cut into cells."""
        triangles = np.asarray(job.occluder_triangles)
        at_corners = _points_at_corners(job, points)
        baked = (at_corners >= 0).all(axis=1)
        side = _cell_side(job)
        levels = np.zeros(len(triangles), np.int32)
        levels[~baked] = _rows_of_cells(job, triangles[~baked], side)
        sizes = np.where(baked, 3, levels.astype(np.int64) ** 2)
        first = np.concatenate([[0], np.cumsum(sizes)])
        count = int(first[-1])
        if 2 * count >= 2**31:
            levels = np.where(baked, 0, 1).astype(np.int32)
            first = np.concatenate([[0], np.cumsum(np.where(baked, 3, 1))])
            count = int(first[-1])
        of_entries = np.full(count, -1, np.int32)
        of_entries[first[:-1][baked][:, None] + np.arange(3)] = at_corners[baked]
        return cls(first[: len(triangles)].astype(np.int32), levels, of_entries, count, side)

    @cached_property
    def has_cells(self) -> bool:
        """Whether anything is not baked."""
        return bool(self.levels.any())

    @cached_property
    def _triangles(self) -> Entry:
        """That of each front entry (count,)."""
        sizes = np.diff(self.first, append=self.count)
        return np.repeat(np.arange(len(sizes), dtype=np.int32), sizes)

    def albedo(self, entries: Index, of_corners: Array) -> Array:
        """The albedo (E, 3) of ``entries`` (E,), ``of_corners`` (F, 3, 3) being that of the
        triangles' corners: a corner's own, interpolated in the middle of a cell."""
        front = entries % self.count
        triangles = self._triangles[front]
        corner = front - self.first[triangles]
        cells = np.flatnonzero(self.levels[triangles]) if self.has_cells else corner[:0]
        corner[cells] = 0
        found = of_corners.reshape(-1, 3)[3 * triangles.astype(np.int64) + corner]
        if len(cells):
            its, barycentric = self.places(entries[cells])
            found[cells] = np.einsum("ek,ekc->ec", barycentric, of_corners[its])
        return np.asarray(found.clip(0, 1), np.float32)

    def drawn(self, met: Met, random: Array) -> Entry:
        """The front entries (R,) of rays that ``met`` something, any number where they did not;
        ``random`` (R,) in [0, 1) draws the corner."""
        found = self.first.take(met.triangles, mode="clip")
        left = 1 - met.v
        corner = (random >= left).view(np.int8)
        left -= met.u
        corner += (random >= left).view(np.int8)
        if self.has_cells:
            level = self.levels.take(met.triangles, mode="clip")
            cells = np.flatnonzero(level)
            corner[cells] = 0
            found[cells] += _cell(level[cells], met.u[cells], met.v[cells])
        found += corner
        return found

    def places(self, entries: Index, towards: int | None = None) -> tuple[Index, Float]:
        """The triangles (E,) and barycentric coordinates (E, 3) in the middle of ``entries``; of
        those that are cells, most of the way from there ``towards`` one of their three corners."""
        front = entries % self.count
        triangles = self._triangles[front].astype(np.int64)
        within, level = front - self.first[triangles], self.levels[triangles]
        n = np.maximum(level, 1).astype(np.int64)
        row = n - np.ceil(np.sqrt(np.maximum(n * n - within, 0))).astype(np.int64)
        rest = within - row * (2 * n - row)
        upper = rest % 2
        third = (1 + upper) / 3
        u, v = row + third, rest // 2 + third
        if towards is not None:
            to_u, to_v = TO_CORNER[towards]
            u, v = u + (1 - 2 * upper) * to_u, v + (1 - 2 * upper) * to_v
        u, v = u / n, v / n
        cells = np.stack([1 - u - v, u, v], axis=1)
        corners = np.full((len(front), 3), (1 - CORNER) / 2)
        at_corner = level == 0
        corners[at_corner, within[at_corner]] = CORNER
        return triangles, np.where(at_corner[:, None], corners, cells)


def _cell(level: Entry, u: Array, v: Array) -> Entry:
    """The cell (R,) of places in triangles of ``level`` (R,) rows: row by row, in each the lower
    and the upper cells taking turns."""
    along, across = u * level, v * level
    row = np.clip(along.astype(np.int32), 0, level - 1)
    column = np.clip(across.astype(np.int32), 0, level - 1 - row)
    upper = ((along - row) + (across - column) > 1) & (row + column < level - 1)
    return np.asarray(row * (2 * level - row) + 2 * column + upper, np.int32)


def _rows_of_cells(job: Job, triangles: Index, side: float) -> Index:
    """How many rows of cells, ``side`` wide at most, each of the occluders' ``triangles`` (F, 3)
    has."""
    corners = np.asarray(job.occluder_vertices, np.float64)[triangles]
    cross = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    size = np.sqrt(np.linalg.norm(cross, axis=1))  # the side of a square of twice its area
    return np.clip(np.ceil(size / side), 1, MOST_ROWS).astype(np.int64)


def _cell_side(job: Job) -> float:
    """How wide a cell is at most."""
    bounds = [e for r in job.receivers for e in (r.vertices.min(axis=0), r.vertices.max(axis=0))]
    extent = float(np.ptp(np.array(bounds, np.float64), axis=0).max()) if bounds else 1.0
    return max(CELL * extent, 1e-30)


def _points_at_corners(job: Job, points: Sequence[Points]) -> Index:
    """For the corners (F, 3) of the occluders' triangles the point of a receiver that they are, -1
    where the triangle is no receiver's.

    A receiver's triangles are found among the occluders by the places of their corners, which are
    the same to the last bit: both are read from the same evaluated mesh.  Mostly they are one
    occluder as it is.
    """
    at_corners = np.full((len(job.occluder_triangles), 3), -1, np.int64)
    before, others = 0, list[tuple[Receiver, Index]]()
    for receiver, its in zip(job.receivers[: len(points)], points, strict=True):
        rows = its.element_points[element_triangles(receiver)].astype(np.int64)
        rows = np.where((rows >= 0).all(axis=1, keepdims=True), rows + before, -1)
        whole = _whole_occluder(job, receiver)
        if whole is None:
            others.append((receiver, rows))
        else:
            at_corners[whole] = rows
        before += len(its.origins)
    if others and len(at_corners):
        _find(job, others, at_corners)
    return at_corners


def _whole_occluder(job: Job, receiver: Receiver) -> slice | None:
    """The occluder whose triangles are those of ``receiver``, one by one."""
    count = len(receiver.triangles)
    its = receiver.vertices.astype(np.float32).take(receiver.triangles, axis=0)
    for start in job.occluder_starts[:-1][np.diff(job.occluder_starts) == count]:
        part = slice(int(start), int(start) + count)
        corners = job.occluder_vertices.take(job.occluder_triangles[part], axis=0)
        if np.array_equal(corners.astype(np.float32), its):
            return part
    return None


def _find(job: Job, receivers: list[tuple[Receiver, Index]], at_corners: Index) -> None:
    """Put the points (F, 3) at the corners of the triangles of ``receivers`` where these are among
    the occluders', whichever corner comes first."""
    keys, turned = _triangle_keys(_place_keys(job.occluder_vertices)[job.occluder_triangles])
    order = np.argsort(keys, kind="stable")
    ordered = keys[order]
    for receiver, rows in receivers:
        mine, my_turned = _triangle_keys(_place_keys(receiver.vertices)[receiver.triangles])
        found = order[np.minimum(np.searchsorted(ordered, mine), len(order) - 1)]
        same = (keys[found] == mine) & (rows[:, 0] >= 0)
        its_points = np.take_along_axis(rows, my_turned, axis=1)[same]
        at_corners[found[same][:, None], turned[found[same]]] = its_points


def _place_keys(vertices: npt.NDArray[Any]) -> Keys:
    """A number (V,) for the place of each of ``vertices`` (V, 3)."""
    bits = (np.asarray(vertices, np.float32) + np.float32(0)).view(np.uint32)  # 0 is not -0
    return mixed(bits.astype(np.uint64).T)


def _triangle_keys(corners: Keys) -> tuple[Keys, Index]:
    """A number (F,) for each triangle whose corners have the numbers ``corners`` (F, 3), whichever
    of them comes first; and the order (F, 3) of the corners from the one that is first here."""
    turned = (corners.argmin(axis=1)[:, None] + np.arange(3)) % 3
    return mixed(np.take_along_axis(corners, turned, axis=1).T), turned
