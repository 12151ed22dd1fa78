"""Where the rays of texels start."""

from collections.abc import Generator
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from ..job import Receiver
from ..surface.points import Points, Surface, element_triangles, surface_bias
from ..surface.samples import Places, starts, stratified_places
from .cover import Float, Index, Layout, barycentric, locate

Array = npt.NDArray[np.float32]

INSIDE = 0.05  # texels: no place lies nearer to an edge of its triangle
MOST_INSIDE = 0.15  # of a triangle's height


@dataclass(frozen=True)
class Mesh:
    """A receiver as rays see it and as it lies in an atlas; its shading ``normals`` (E, 3) are
    those of ``elements`` (F, 3)."""

    surface: Surface
    layout: Layout
    elements: npt.NDArray[np.int32]
    normals: Array

    @classmethod
    def of(cls, receiver: Receiver, uvs: Array, size: int) -> "Mesh":
        """``receiver`` in an atlas of ``size``², with ``uvs`` (C, 2)."""
        normals = np.nan_to_num(np.asarray(receiver.normals), nan=0, posinf=0, neginf=0)
        layout = Layout.of(receiver, uvs, size)
        return cls(Surface.of(receiver), layout, element_triangles(receiver), normals)

    def places(self, texels: Index, triangles: Index, offset: Float) -> Places:
        """The places on ``triangles`` (M,) nearest to ``offset`` texels (2,) from the centres of
        ``texels`` (M,), but not at an edge: there Embree may miss, and a wall may stand."""
        size = self.layout.size
        centres = np.stack([texels % size, texels // size], axis=1)
        corners = self.layout.corners[triangles]
        inside = np.maximum(barycentric(corners, centres + offset), self._least(triangles))
        return Places(triangles, inside / inside.sum(axis=1, keepdims=True))

    def _least(self, triangles: Index) -> Float:
        """The least coordinates (M, 3) of a place on each triangle."""
        flat, solid = self.layout.corners[triangles], self.surface.corners[triangles]
        first, second = flat[:, 1] - flat[:, 0], flat[:, 2] - flat[:, 0]
        area = np.abs(first[:, 0] * second[:, 1] - first[:, 1] * second[:, 0])
        away = 4 * surface_bias(solid)[:, 0]
        least = np.empty((len(triangles), 3))
        for k in range(3):
            in_atlas = np.linalg.norm(flat[:, k - 1] - flat[:, k - 2], axis=1)
            in_world = np.linalg.norm(solid[:, k - 1] - solid[:, k - 2], axis=1)
            of_height = INSIDE * in_atlas / np.maximum(area, 1e-30)
            of_bias = away * in_world / np.maximum(2 * self.surface.areas[triangles], 1e-300)
            least[:, k] = np.minimum(np.maximum(of_height, of_bias), MOST_INSIDE)
        return least

    def starts(self, places: Places) -> tuple[Array, Array]:
        """Ray origins and unit shading normals (M, 3) at ``places``."""
        found = starts(self.surface, self.elements, self.normals, places)
        return found[0].astype(np.float32), found[1].astype(np.float32)

    def at(
        self, texels: Index, offset: Float
    ) -> Generator[int, None, tuple[npt.NDArray[np.bool_], Places]]:
        """Which of the ``texels`` (M,) reads may touch, and the places nearest to ``offset`` from
        their centres.  All are different.  Yields 0 now and then."""
        triangles = yield from locate(self.layout, self.surface.solid, offset, texels)
        found = triangles >= 0
        return found, self.places(texels[found], triangles[found], offset)


def pilot_points(receiver: Receiver, count: int = 4096, seed: int = 0) -> Points:
    """At most ``count`` points spread evenly over the area of ``receiver``, for finding out how
    many rays a texel takes; their ``element_points`` are empty."""
    surface = Surface.of(receiver)
    chosen = np.flatnonzero(surface.solid)
    none = np.empty(0, np.int32)
    if not len(chosen):
        nothing = np.empty((0, 3), np.float32)
        return Points(nothing, nothing, none)
    places = stratified_places(surface, chosen, surface.areas[chosen], count, seed)
    normals = np.nan_to_num(np.asarray(receiver.normals), nan=0, posinf=0, neginf=0)
    origins, facing = starts(surface, element_triangles(receiver), normals, places)
    return Points(origins.astype(np.float32), facing.astype(np.float32), none)
