"""A mesh as a fit sees it: the quadratic forms of what was found on it, and of how far its values
bend at the edges."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import numpy.typing as npt

from ..surface.points import Float, Index
from ..surface.samples import Places

Array = npt.NDArray[np.float32]

ROWS = 1024  # points whose samples are summed together: they stay in the processor's cache
NEEDLE = 0.05  # a triangle counts as at least this high, of the two triangles at an edge


@dataclass(frozen=True)
class Mesh:
    """Triangles ``corners`` (F, 3) over ``count`` points, their ``areas`` (F,), and what joins
    them: ``edges`` (E, 2), the lower point first, and ``sides`` (F, 3), the edge from each corner
    to the next.  Edges of two triangles are ``hinges`` (H, 4): the edge's ends and the corners
    opposite; ``jumps`` (H, 4) times the values there is the jump of the gradient across the edge,
    ``hinge_areas`` (H,) the area of both triangles, and ``hinge_sides`` (H, 5) the edge itself and
    those from the first end, the second, to the first tip, then to the second."""

    count: int
    corners: Index
    areas: Float
    edges: Index
    sides: Index
    hinges: Index
    jumps: Float
    hinge_areas: Float
    hinge_sides: Index


def mesh_of(corners: Index, positions: Float, areas: Float, count: int) -> Mesh:
    """The mesh of triangles ``corners`` (F, 3) over ``count`` points, positions (F, 3, 3)."""
    keys = [_keys(corners[:, k], corners[:, (k + 1) % 3], count) for k in range(3)]
    key = np.stack(keys, axis=1).reshape(-1)
    order = np.argsort(key, kind="stable")
    key = key.take(order)
    is_first = np.append(True, key[1:] != key[:-1])
    sides = np.empty_like(order)
    sides[order] = np.cumsum(is_first) - 1
    starts = np.flatnonzero(is_first)
    found, uses = key.take(starts), np.diff(starts, append=len(key))
    edges = np.stack([found // count, found % count], axis=1)
    own = np.flatnonzero(uses == 2)
    first = starts.take(own)
    halves = order.take(np.stack([first, first + 1]))  # (2, H) of 3 F
    ends = edges.take(own, 0)
    flat = corners.reshape(-1)
    reversed_ = flat.take(halves) != ends[:, 0]
    along, height = (values.reshape(-1).take(halves) for values in _heights(positions, areas))
    along = np.where(reversed_, 1 - along, along)
    height = 1 / np.maximum(height, NEEDLE * (height[0] + height[1]))
    towards_first, towards_second = (1 - along) * height, along * height
    jumps = np.stack([-towards_first.sum(axis=0), -towards_second.sum(axis=0), *height], axis=1)
    side = halves % 3
    after, before = halves + np.where(side == 2, -2, 1), halves + np.where(side == 0, 2, -1)
    tips = flat.take(before)
    around = [own, *_sides_around(sides.take(after), sides.take(before), reversed_)]
    hinges = np.stack([ends[:, 0], ends[:, 1], *tips], axis=1)
    hinge_areas = areas.take(halves // 3).sum(axis=0)
    return Mesh(
        count, corners, areas, edges, sides.reshape(-1, 3), hinges, jumps,
        hinge_areas, np.stack(around, axis=1),
    )  # fmt: skip


def _keys(start: Index, end: Index, count: int) -> Index:
    """One number for each side (F,) from a point to another, whichever comes first."""
    return np.asarray(np.minimum(start, end) * count + np.maximum(start, end))


def unjoined(corners: Index, areas: Float, count: int) -> Mesh:
    """The mesh of triangles ``corners`` (F, 3) without what joins them, where nothing is fitted."""
    none = np.zeros((0, 2), np.int64)
    numbers, sides = np.zeros((0, 4)), np.zeros((0, 3), np.int64)
    hinges, around = np.zeros((0, 4), np.int64), np.zeros((0, 5), np.int64)
    return Mesh(count, corners, areas, none, sides, hinges, numbers, np.zeros(0), around)


def excerpt(mesh: Mesh, keep: npt.NDArray[np.bool_]) -> Mesh:
    """What of ``mesh`` lies among the points ``keep`` (P,), with points, edges and triangles
    numbered anew."""
    points, edge = np.cumsum(keep) - 1, keep[mesh.edges].all(axis=1)
    triangle, hinge = keep[mesh.corners].all(axis=1), keep[mesh.hinges].all(axis=1)
    edges = np.cumsum(edge) - 1
    return Mesh(
        int(keep.sum()),
        points[mesh.corners[triangle]],
        mesh.areas[triangle],
        points[mesh.edges[edge]],
        edges[mesh.sides[triangle]],
        points[mesh.hinges[hinge]],
        mesh.jumps[hinge],
        mesh.hinge_areas[hinge],
        edges[mesh.hinge_sides[hinge]],
    )


def _heights(positions: Float, areas: Float) -> tuple[Float, Float]:
    """For each side (F, 3) of triangles: how far along it the third corner's foot lies, from where
    the side starts, and the corner's height."""
    along, height = np.empty((2, len(positions), 3))
    corners = [np.ascontiguousarray(positions[:, k].T) for k in range(3)]
    sides = [corners[(k + 1) % 3] - corners[k] for k in range(3)]
    for k, side in enumerate(sides):
        squared = np.maximum(np.einsum("cf,cf->f", side, side), 1e-300)
        along[:, k] = -np.einsum("cf,cf->f", sides[k - 1], side) / squared
        height[:, k] = 2 * areas / np.sqrt(squared)
    return along, height


def _sides_around(
    after: Index, before: Index, reversed_: npt.NDArray[np.bool_]
) -> tuple[Index, Index, Index, Index]:
    """The other edges (H,) of both triangles at an edge: from its first end and its second to
    the first tip, then to the second.  ``after`` and ``before`` it (2, H) in each triangle, which
    runs the other way where ``reversed_`` (2, H)."""
    from_first, from_second = np.where(reversed_, after, before), np.where(reversed_, before, after)
    return from_first[0], from_second[0], from_first[1], from_second[1]


@dataclass(frozen=True)
class Quadratic:
    """A symmetric form over the points: its diagonal (P,), its entries at the edges (E,) and
    between the tips of the hinges (H,)."""

    diagonal: Float
    edges: Float
    tips: Float

    def times(self, factor: float) -> "Quadratic":
        """This form, ``factor`` times."""
        return Quadratic(factor * self.diagonal, factor * self.edges, factor * self.tips)


def sample_form(mesh: Mesh, places: Places, weights: Float) -> Quadratic:
    """The sum of ``weights`` (S,) times the square of the value interpolated at ``places``."""
    corners, sides = mesh.corners[places.triangles], mesh.sides[places.triangles]
    b = places.barycentric
    own = weights[:, None] * b * b
    between = weights[:, None] * b * b[:, [1, 2, 0]]
    return Quadratic(
        np.bincount(corners.reshape(-1), own.reshape(-1), mesh.count),
        np.bincount(sides.reshape(-1), between.reshape(-1), len(mesh.edges)),
        np.zeros(len(mesh.hinges)),
    )


def jump_form(mesh: Mesh, weights: Float) -> Quadratic:
    """The sum over the hinges of ``weights`` (H,) times a sixth of their squared area times the
    square of the gradient's jump."""
    energy = weights * mesh.hinge_areas**2 / 6
    a, b, c, d = mesh.jumps.T
    edges = np.zeros(len(mesh.edges))
    for k, product in enumerate((a * b, a * c, b * c, a * d, b * d)):
        edges += np.bincount(mesh.hinge_sides[:, k], energy * product, len(edges))
    diagonal = np.bincount(
        mesh.hinges.reshape(-1), (energy[:, None] * mesh.jumps**2).reshape(-1), mesh.count
    )
    return Quadratic(diagonal, edges, energy * c * d)


def bends(mesh: Mesh, values: Array) -> Float:
    """For each hinge (H,) the squared area times the mean square of the gradient's jump of
    ``values`` (P, K)."""
    found = np.empty(len(mesh.hinges))
    for start in range(0, len(found), ROWS):
        its = slice(start, start + ROWS)
        hinges, jumps = mesh.hinges[its], mesh.jumps[its].astype(np.float32)
        jump = sum(jumps[:, k : k + 1] * values.take(hinges[:, k], 0) for k in range(4))
        found[its] = np.square(jump).mean(axis=1) * mesh.hinge_areas[its] ** 2
    return found


class Spread:
    """Samples at ``places`` (S,) with ``weights`` (S,), spread over the corners of their triangles.
    All but their values is found once."""

    def __init__(self, mesh: Mesh, places: Places, weights: Float) -> None:
        self._mesh = mesh
        corners = mesh.corners[places.triangles].reshape(-1)
        shares = (weights[:, None] * places.barycentric).astype(np.float32)
        order = np.argsort(corners, kind="stable")
        self._samples, self._shares = order // 3, shares.reshape(-1, 1)[order]
        self._touched, self._first = np.unique(corners[order], return_index=True)
        total = self.sums(np.ones((len(places), 1), np.float32))
        self._known = total[:, 0] > 0
        self._total = np.where(total > 0, total, 1).astype(np.float32)

    def sums(self, values: Array) -> Array:
        """What the form of the samples is to give (P, K) where these are their ``values``
        (S, K)."""
        out = np.zeros((self._mesh.count, values.shape[1]), np.float32)
        ends = np.append(self._first[ROWS::ROWS], len(self._samples))
        for low, end in zip(range(0, len(self._touched), ROWS), ends, strict=False):
            first, points = self._first[low : low + ROWS], self._touched[low : low + ROWS]
            spread = values.take(self._samples[first[0] : end], axis=0)
            spread *= self._shares[first[0] : end]
            out[points] = np.add.reduceat(spread, first - first[0], axis=0)
        return out

    def averages(self, sums: Array) -> Array:
        """Averages (P, K) of the samples about each point, from their ``sums`` (P, K); of the
        neighbours' where it has none."""
        out: Array = sums / self._total
        for rows, first, count, sources in self._rounds:
            out[rows] = np.add.reduceat(out[sources], first, axis=0) / count
        return out

    @cached_property
    def _rounds(self) -> list[tuple[Index, Index, Array, Index]]:
        """Points without samples that lie beside others, round by round: where the neighbours of
        each begin among the ``sources``, and how many they are (R, 1)."""
        known, found = self._known.copy(), []
        pairs = np.concatenate([self._mesh.edges, self._mesh.edges[:, ::-1]])
        while not known.all():
            pairs = pairs[~known[pairs[:, 0]]]
            ready = pairs[known[pairs[:, 1]]]
            ready = ready[np.argsort(ready[:, 0], kind="stable")]
            rows, first, count = np.unique(ready[:, 0], return_index=True, return_counts=True)
            if not len(rows):
                break
            found.append((rows, first, count[:, None].astype(np.float32), ready[:, 1]))
            known[rows] = True
        return found


def interpolated(mesh: Mesh, places: Places, values: Array) -> Array:
    """``values`` (P, K) of the points at ``places``, (S, K)."""
    corners = mesh.corners[places.triangles]
    b = places.barycentric.astype(np.float32)
    shown = b[:, :1] * values[corners[:, 0]]
    for k in (1, 2):
        shown += b[:, k : k + 1] * values[corners[:, k]]
    return np.asarray(shown, np.float32)
