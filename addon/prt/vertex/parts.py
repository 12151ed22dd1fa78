"""What of a receiver may be fitted: islands of enough triangles."""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from ..job import Receiver, Settings
from ..surface.edges import components
from ..surface.points import Float, Index, Points, Surface, element_triangles
from ..surface.samples import Places
from .fit_mesh import Mesh, mesh_of, unjoined

MIN_RAYS = 32  # of a sample
MIN_TRIANGLES = 500  # of a part
OWN = 2000  # triangles of an island that is a part of its own: it can be judged by itself
MIN_ISLAND = 64  # triangles: what is smaller is left to its points
BY_COUNT = 0.75  # of the samples as many in each triangle; the others by area


@dataclass(frozen=True)
class Parts:
    """A receiver's sound triangles over its P points: ``mesh``, their ``surface``; the part of
    each point (P,) and triangle (F,), of ``count``; the last part is what is not to be fitted."""

    mesh: Mesh
    surface: Surface
    of_points: Index
    of_triangles: Index
    count: int

    @property
    def rest(self) -> int:
        """The part that is not to be fitted."""
        return self.count - 1

    def sizes(self) -> Index:
        """Points (count,) of each part."""
        return np.bincount(self.of_points, minlength=self.count)

    def areas(self) -> Float:
        """The area (count,) of each part."""
        return np.bincount(self.of_triangles, self.surface.areas, self.count)

    def triangles(self) -> list[Index]:
        """The triangles of each part."""
        if self.count == 1:
            return [np.arange(len(self.of_triangles))]
        order = np.argsort(self.of_triangles, kind="stable")
        ends = np.cumsum(np.bincount(self.of_triangles, minlength=self.count))
        return np.split(order, ends[:-1])

    def density(self, triangles: Index) -> Float:
        """The share of a part's samples that each of its ``triangles`` takes."""
        areas = self.surface.areas[triangles]
        return (1 - BY_COUNT) * areas / areas.sum() + BY_COUNT / max(1, len(areas))

    def homes(self) -> Places:
        """Every point as a place in one of its triangles; all of it 0 where it has none, and where
        nothing is fitted, so that nobody asks."""
        corners, count = self.mesh.corners, self.mesh.count
        triangles, barycentric = np.zeros(count, np.int64), np.zeros((count, 3))
        if self.count == 1:
            return Places(triangles, barycentric)
        for k in range(3):
            triangles[corners[:, k]] = np.arange(len(corners))
        if len(corners):
            barycentric[:] = corners[triangles] == np.arange(count)[:, None]
        return Places(triangles, barycentric)

    def corners_of(self, places: Places) -> Index:
        """The points, ascending, at the corners of the triangles of ``places``."""
        is_one = np.zeros(self.mesh.count, bool)
        is_one[self.mesh.corners[places.triangles]] = True
        return np.flatnonzero(is_one)

    def point_areas(self) -> Float:
        """A third of the area of the triangles about each point (P,)."""
        thirds = np.repeat(self.surface.areas / 3, 3)
        return np.bincount(self.mesh.corners.reshape(-1), thirds, self.mesh.count)


def may_fit(receiver: Receiver, settings: Settings, rays: int) -> bool:
    """Whether ``parts_of`` the receiver may be fitted, out of so many ``rays`` a point."""
    return settings.fit and rays >= 2 * MIN_RAYS and len(receiver.triangles) >= MIN_TRIANGLES


def parts_of(receiver: Receiver, points: Points, may_fit: bool) -> Parts:
    """Large islands of ``points``, smaller ones together as one more if that is enough, and the
    rest.  Only triangles with an area and three different points."""
    whole = Surface.of(receiver)
    rows = points.element_points[element_triangles(receiver)].astype(np.int64)
    a, b, c = rows.T
    sound = whole.solid & (a >= 0) & (b >= 0) & (c >= 0) & (a != b) & (b != c) & (c != a)
    surface = whole
    if not sound.all():
        surface, rows = whole.only(sound), rows[sound]
    count = len(points.origins)
    if not may_fit:
        bare = unjoined(rows, surface.areas, count)
        of_points, of_triangles = np.zeros(count, np.int64), np.zeros(len(bare.corners), np.int64)
        return Parts(bare, surface, of_points, of_triangles, 1)
    mesh = mesh_of(rows, surface.corners_of(slice(None)), surface.areas, count)
    island = components(mesh.edges, count)
    size = np.bincount(island[mesh.corners[:, 0]], minlength=count)  # triangles, by island
    large, small = size >= OWN, (size >= MIN_ISLAND) & (size < OWN)
    pooled = size[small].sum() >= MIN_TRIANGLES
    rest = int(large.sum()) + int(pooled)
    part = np.full(count, rest)
    part[large] = np.arange(large.sum())
    if pooled:
        part[small] = rest - 1
    of_points = part[island]
    return Parts(mesh, surface, of_points, of_points[mesh.corners[:, 0]], rest + 1)


def joined(places: list[Places]) -> Places:
    """All of ``places``."""
    if not places:
        return Places(np.zeros(0, np.int64), np.zeros((0, 3)))
    return Places(
        np.concatenate([p.triangles for p in places]),
        np.concatenate([p.barycentric for p in places]),
    )


Mask = npt.NDArray[np.bool_]


def buried_points(mesh: Mesh, seen: Places, unseen: Places) -> Mask:
    """Points (P,) about which all places that were looked at are buried, ``unseen``; a point about
    which there is none is like its neighbours, and seen if one of them is."""
    has_seen, has_unseen = (_touched(mesh, places) for places in (seen, unseen))
    hidden, known = has_unseen & ~has_seen, has_unseen | has_seen
    pairs = np.concatenate([mesh.edges, mesh.edges[:, ::-1]])
    while True:
        pairs = pairs[~known[pairs[:, 0]]]
        ready = pairs[known[pairs[:, 1]]]
        if not len(ready):
            return hidden
        lit = np.bincount(ready[:, 0], ~hidden[ready[:, 1]], mesh.count)
        fresh = np.unique(ready[:, 0])
        hidden[fresh] = lit[fresh] == 0
        known[fresh] = True


def _touched(mesh: Mesh, places: Places) -> Mask:
    touched = np.zeros(mesh.count, bool)
    touched[mesh.corners[places.triangles][places.barycentric > 0]] = True
    return touched
