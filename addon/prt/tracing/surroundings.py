"""What stands about a receiver: what can shadow it, and whether a look at the horizon pays."""

from collections.abc import Callable
from functools import cached_property

import numpy as np

from ..job import Receiver
from ..surface.convex import is_convex
from ..surface.points import Points
from .clusters import Clusters, Float, Index, highest, lowest
from .flats import Parts
from .hemisphere import GROUP
from .horizon import Horizon

WORTH = 0.05  # of the rays have to be saved by a sample of the blocks
SAMPLE, BLOCK = 64, 64  # blocks, and their points
LOOKED_AT = 2  # every second one of them, as its horizon is dear among many occluders
FLAT = 1e-4
CURVED, FLOORS = 512, 4096  # cells that occluders lie in, of which curved bodies look at each
LOOK_RAYS, CLUSTER_RAYS = 32, 12  # to the sky, that take as long as a place or triangle takes
REACH_BLOCKS = 256


class Surroundings:
    """All ``occluders``, and what gives the ``fewer`` triangles that cover the same."""

    def __init__(self, occluders: Parts, fewer: Callable[[], Parts]) -> None:
        self._vertices, self._triangles = occluders.vertices, occluders.triangles
        self._starts = occluders.starts
        self._fewer, self._made = fewer, dict[int, Clusters]()

    def _clusters(self, most: int) -> Clusters:
        """Of all, in about ``most`` cells and sides; made once."""
        if most not in self._made:
            self._made[most] = Clusters.of(self._fewer(), most)
        return self._made[most]

    @cached_property
    def _boxes(self) -> Float:
        """Lowest and highest corner (O, 6) of every part."""
        places = self._vertices[self._triangles]
        filled = np.flatnonzero(np.diff(self._starts) > 0)
        boxes = np.full((len(self._starts) - 1, 6), np.nan)
        boxes[filled, :3] = np.minimum.reduceat(lowest(places), self._starts[filled])
        boxes[filled, 3:] = np.maximum.reduceat(highest(places), self._starts[filled])
        return boxes

    def horizon(self, receiver: Receiver, points: Points, places: int, rays: int) -> Horizon | None:
        """What rises above the tangent planes of ``points`` of ``receiver``, of whose surface so
        many ``places`` are to have ``rays`` each; None where a look at some of them says that
        knowing it would hardly save a ray, or less time than it takes.

        Only a flat surface or a convex body does not stand in its own light everywhere.
        """
        if not len(self._triangles) or not self._pays(places, rays):
            return None
        rows = _sample(points)
        flat = _flat_share(points, rows)
        convex = flat < 1 and is_convex(receiver)  # what is flat does not rise above itself
        if not convex and flat < WORTH:
            return None
        clusters = self._clusters(CURVED if convex else FLOORS)
        if convex:
            clusters = clusters.without(self._parts_like(receiver))
        found = Horizon(clusters, looks_at_curved=convex)
        groups = rows[::LOOKED_AT, : min(GROUP, rows.shape[1])]
        saved = found.open_shares(points.origins[groups], points.normals[groups]).mean()
        return found if saved > WORTH and self._pays(places, saved * rays) else None

    def _pays(self, places: int, saved: float) -> bool:
        """Whether so many rays ``saved`` a place take longer than finding them."""
        clusters = 0 if self._made else CLUSTER_RAYS * len(self._fewer().triangles)
        return places * (saved - LOOK_RAYS) > clusters

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
    last = max(0, count - BLOCK)
    starts = np.linspace(0, last, min(SAMPLE, last + 1)).astype(np.int64)
    return np.asarray(np.minimum(starts[:, None] + np.arange(BLOCK), count - 1))


def _flat_share(points: Points, rows: Index) -> float:
    """The share of the blocks whose points lie in one plane across their normals."""
    places = points.origins[rows].astype(np.float64)
    normals = points.normals[rows].astype(np.float64)
    offset = places - places[:, :1]
    height = np.abs(np.einsum("bkc,bc->bk", offset, normals[:, 0])).max(axis=1)
    width = np.abs(offset).max(axis=(1, 2))
    turned = np.abs(normals - normals[:, :1]).max(axis=(1, 2))
    return float(((height <= FLAT * width) & (turned <= FLAT)).mean())
