"""The charts of a piece, mended until every polygon lies in one chart.

xatlas knows triangles only.  It may cut a polygon in two, whose corners then had two UVs each, and
leaves out triangles that it finds degenerate.  Such a polygon is moved whole into one of the charts
that it touches: to where the chart has its vertices already, or unfolded over the edge that they
share.  Where it would lie over something it becomes a chart of its own.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from ..surface.points import Float, Index
from .overlap import over_any, over_each_other
from .plane import cross_products, plane_areas, projected, sums, unfolded

NEITHER = -1  # the chart of a triangle that lies nowhere
COLLAPSED = 1e-3  # of its area is left in the plane
LONGER = 3.0  # than in space: no side of a moved polygon
NEAR = 0.5  # of an edge: a vertex no farther from where it would unfold to stays


@dataclass
class Layout:
    """Triangles of a piece: ``corners`` (F, 3, 3) in space, their ``vertices`` (F, 3) and the
    polygons' ``loops`` (F, 3), numbers of corners; in the plane, in the same unit, ``uvs``
    (F, 3, 2), and the chart of each (F,)."""

    corners: Float
    vertices: Index
    loops: Index
    uvs: Float
    charts: Index

    def true_to_scale(self) -> None:
        """Take out what a chart is stretched by as a whole, however it was packed, and mirrored;
        what has collapsed, lies the wrong way round or over something else lies nowhere."""
        self._unstretch()
        self.level()
        area = 0.5 * np.linalg.norm(cross_products(self.corners), axis=1)
        lost = ~(plane_areas(self.uvs) > COLLAPSED * area)
        self.charts[lost] = NEITHER
        rim = self._rim()
        for chart in range(self._count()):
            inside = np.flatnonzero(self.charts == chart)
            if over_each_other(self.uvs[inside[rim[inside]]]).any():
                self.charts[inside[over_each_other(self.uvs[inside])]] = NEITHER

    def mend(self) -> None:
        """Bring every polygon together in one chart."""
        for polygon in self._torn():
            if not any(self.move(polygon, chart) for chart in self.candidates(polygon)):
                self.uvs[polygon] = self._alone(polygon)
                self.charts[polygon] = self.charts.max(initial=NEITHER) + 1

    def _rim(self) -> npt.NDArray[np.bool_]:
        """Triangles (F,) with a side that no other one of their chart has.  Where none of these lie
        over one another nothing does: what is not folded can only run over itself from its border.
        """
        start, after = np.arange(self.vertices.size), np.arange(self.vertices.size)
        after = after - after % 3 + (after + 1) % 3
        vertices, uvs = self.vertices.reshape(-1), self.uvs.reshape(-1, 2)
        turned = vertices[start] > vertices[after]
        low, high = np.where(turned, after, start), np.where(turned, start, after)
        charts = np.repeat(self.charts, 3)
        order = np.lexsort((vertices[high], vertices[low], charts))
        low, high, charts = low[order], high[order], charts[order]
        same = (charts[1:] == charts[:-1]) & (vertices[low[1:]] == vertices[low[:-1]])
        same &= vertices[high[1:]] == vertices[high[:-1]]
        for ends in (low, high):
            same &= (uvs[ends[1:]] == uvs[ends[:-1]]).all(axis=1)
        shared = np.zeros(len(order), bool)
        shared[:-1] |= same
        shared[1:] |= same
        rim = np.zeros(len(self.charts), bool)
        rim[order[~shared] // 3] = True
        return rim

    def _unstretch(self) -> None:
        """Give every chart the linear map that makes its mean stretch, over the surface, none."""
        count, placed = self._count(), self.charts >= 0
        flat = unfolded(self.corners)
        length, x, height = flat[:, 1, 0], flat[:, 2, 0], flat[:, 2, 1]
        placed &= height > 1e-3 * np.maximum(length, 1e-300)
        group = self.charts[placed]
        length, x, height = length[placed], x[placed], height[placed]
        first = (self.uvs[placed, 1] - self.uvs[placed, 0]) / length[:, None]
        second = self.uvs[placed, 2] - self.uvs[placed, 0] - first * x[:, None]
        second /= height[:, None]
        products = [(a, b) for a, b in ((0, 0), (0, 1), (1, 1))]
        metric = np.stack(
            [first[:, a] * first[:, b] + second[:, a] * second[:, b] for a, b in products], 1
        )
        weight = length * height
        total = np.bincount(group, weight, count)
        mean = sums(metric * weight[:, None], group, count) / np.where(total > 0, total, 1)[:, None]
        mean[total == 0] = (1, 0, 1)
        values, axes = np.linalg.eigh(mean[:, [0, 1, 1, 2]].reshape(-1, 2, 2))
        values = np.maximum(values, np.maximum(1e-12 * values[:, 1:], 1e-300))
        inverse = np.einsum("nij,nj,nkj->nik", axes, 1 / np.sqrt(values), axes)
        chosen = self.charts >= 0
        self.uvs[chosen] = np.einsum("fij,fkj->fki", inverse[self.charts[chosen]], self.uvs[chosen])

    def level(self) -> None:
        """Charts run anticlockwise and have their surface's area."""
        count, placed = self._count(), self.charts >= 0
        group = self.charts[placed]
        area = 0.5 * np.linalg.norm(cross_products(self.corners[placed]), axis=1)
        signed = np.bincount(group, plane_areas(self.uvs[placed]), count)
        truth = np.bincount(group, area, count)
        scale = np.sqrt(truth / np.where(signed == 0, 1, np.abs(signed)))[group]
        self.uvs[placed] *= scale[:, None, None]
        self.uvs[placed, :, 0] *= np.where(signed < 0, -1, 1)[group, None]

    def _count(self) -> int:
        return int(self.charts.max(initial=NEITHER)) + 1

    def _torn(self) -> Iterator[Index]:
        """The triangles of each polygon whose corners have several UVs, or none."""
        flat = self.loops.reshape(-1)
        order = np.argsort(flat, kind="stable")
        same = flat[order][1:] == flat[order][:-1]
        uvs, charts = self.uvs.reshape(-1, 2)[order], np.repeat(self.charts, 3)[order]
        differ = (uvs[1:] != uvs[:-1]).any(axis=1) | (charts[1:] != charts[:-1])
        torn = set((order[1:][same & differ] // 3).tolist())
        torn |= set(np.flatnonzero(self.charts < 0).tolist())
        done = set[int]()
        for triangle in sorted(torn):
            if triangle not in done:
                polygon = self._polygon(triangle)
                done |= set(polygon.tolist())
                yield polygon

    def _polygon(self, triangle: int) -> Index:
        """The triangles that share corners with ``triangle``, and so on."""
        found = np.zeros(len(self.loops), bool)
        found[triangle] = True
        while True:
            more = np.isin(self.loops, self.loops[found]).any(axis=1)
            if (more == found).all():
                return np.flatnonzero(found)
            found = more

    def candidates(self, polygon: Index) -> list[int]:
        """Charts that ``polygon`` lies in or touches, those that hold most of it first."""
        inside = self.charts[polygon]
        held = np.zeros(self._count() + 1)
        area = np.linalg.norm(cross_products(self.corners[polygon]), axis=1)
        np.add.at(held, inside, np.where(inside >= 0, area, 0))
        touching = np.isin(self.vertices, self.vertices[polygon]).sum(axis=1) >= 2
        beside = np.bincount(self.charts[touching & (self.charts >= 0)], minlength=len(held))
        order = np.lexsort((np.arange(len(held)), -beside, -held))
        return [int(chart) for chart in order if beside[chart]]

    def move(self, polygon: Index, chart: int, least: float = 0.0) -> bool:
        """Move ``polygon`` into ``chart``, if there is room for it, and no side of it becomes
        shorter than ``least`` times what it is in space."""
        inside = self.charts == chart
        staying = polygon[inside[polygon]]
        inside[polygon] = False
        known = dict(self._corner_uvs(staying))
        if not known:
            known = self._shared(polygon, inside)
        uvs = self._unfold(polygon, known, inside)
        if uvs is None or _folded(uvs) or self._distorted(polygon, uvs, least):
            return False
        if over_any(uvs, self.uvs[inside]).any():
            return False
        self.uvs[polygon], self.charts[polygon] = uvs, chart
        return True

    def _distorted(self, polygon: Index, uvs: Float, least: float) -> bool:
        """Whether a side of ``polygon`` is much longer in its ``uvs`` (T, 3, 2) than in space, as
        slivers become that are unfolded over their shortest side, or shorter than ``least``."""
        solid = self.corners[polygon]
        found = np.linalg.norm(uvs - uvs[:, [1, 2, 0]], axis=2)
        sides = np.linalg.norm(solid - solid[:, [1, 2, 0]], axis=2)
        return bool(((found > LONGER * sides) | (found < least * sides)).any())

    def _corner_uvs(self, triangles: Index) -> Iterator[tuple[int, Float]]:
        for triangle in triangles:
            yield from zip(self.vertices[triangle].tolist(), self.uvs[triangle], strict=True)

    def _shared(self, polygon: Index, inside: "np.ndarray") -> dict[int, Float]:
        """The two ends of an edge that ``polygon`` shares with triangles ``inside`` of a chart."""
        for triangle in polygon:
            found = np.isin(self.vertices, self.vertices[triangle]) & inside[:, None]
            for other in np.flatnonzero(found.sum(axis=1) == 2)[:1]:
                ends = np.flatnonzero(found[other])
                return {int(self.vertices[other, k]): self.uvs[other, k] for k in ends}
        return {}

    def _unfold(
        self, polygon: Index, known: dict[int, Float], inside: "np.ndarray"
    ) -> Float | None:
        """UVs (T, 3, 2) of ``polygon`` from those ``known`` at some of its vertices; None where it
        can't be."""
        missing = [int(t) for t in polygon if not known.keys() >= set(self.vertices[t].tolist())]
        while missing:
            ready = [t for t in missing if sum(v in known for v in self.vertices[t].tolist()) == 2]
            if not ready:
                break
            triangle = ready[0]
            k = next(k for k in range(3) if int(self.vertices[triangle, k]) not in known)
            known[int(self.vertices[triangle, k])] = self._third(triangle, k, known, inside)
            missing = [t for t in missing if not known.keys() >= set(self.vertices[t].tolist())]
        if missing:
            return None
        return np.array([[known[v] for v in self.vertices[t].tolist()] for t in polygon])

    def _third(self, triangle: int, k: int, known: dict[int, Float], inside: "np.ndarray") -> Float:
        """Where corner ``k`` of ``triangle`` comes to lie, its others being ``known``: on the
        nearest UV that its vertex has in the chart, or unfolded."""
        start, end = (known[int(self.vertices[triangle, (k + i) % 3])] for i in (1, 2))
        flat = unfolded(self.corners[triangle, [(k + 1) % 3, (k + 2) % 3, k]][None])[0]
        side = end - start
        share = flat[2] / max(float(flat[1, 0]), 1e-300)
        place = start + share[0] * side + share[1] * np.array([-side[1], side[0]])
        there = inside[:, None] & (self.vertices == self.vertices[triangle, k])
        if there.any():
            uvs = self.uvs[there]
            distance = np.hypot(*(uvs - place).T)
            nearest = distance.argmin()
            if distance[nearest] <= NEAR * np.hypot(*side):
                return np.asarray(uvs[nearest])
        return np.asarray(place)

    def _alone(self, polygon: Index) -> Float:
        """UVs (T, 3, 2) of ``polygon`` by itself: unfolded, or seen along its normal where that
        would lie over itself."""
        nowhere = np.zeros(len(self.charts), bool)
        first = unfolded(self.corners[polygon[:1]])[0]
        known = dict(zip(self.vertices[polygon[0]].tolist(), first, strict=True))
        uvs = self._unfold(polygon, known, nowhere)
        if uvs is not None and not _folded(uvs):
            return uvs
        cross = cross_products(self.corners[polygon]).sum(axis=0)
        normal = cross / max(float(np.linalg.norm(cross)), 1e-300)
        return projected(self.corners[polygon].reshape(-1, 3), normal).reshape(-1, 3, 2)


def _folded(uvs: Float) -> bool:
    """Whether a polygon's triangles (T, 3, 2) lie the wrong way round or over one another."""
    if not (plane_areas(uvs) > 0).all():
        return True
    return any(over_any(uvs[i : i + 1], uvs[i + 1 :])[0] for i in range(len(uvs) - 1))
