"""What lies at the edges of a receiver's triangles: smooth surface that goes on in the atlas, a
seam, where it goes on elsewhere in the atlas, or nothing that may be joined."""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from ..job import Receiver
from ..surface.edges import components
from ..surface.points import Surface, element_triangles
from .cover import Float, Index, Layout

SAME_NORMAL = 1e-3  # a crease turns by more; what Blender packs custom normals into, by less
SAME_PLACE = 1e-3  # texels


@dataclass(frozen=True)
class Edges:
    """Of F triangles: the ``chart`` (F,) that each is in, and the ``region`` (F,), a smooth piece
    of a chart, both as the number of one of its triangles; and the seams,
    edges of exactly two triangles with equal shading normals that lie apart in the atlas: the ends
    of both of their sides in texels, ``seams`` (S, 2 sides, 2 ends, 2), the same end first."""

    chart: Index
    region: Index
    seams: Float


def edges_of(receiver: Receiver, surface: Surface, layout: Layout) -> Edges:
    """The edges between the triangles of ``receiver`` that have an area."""
    triangles = np.flatnonzero(surface.solid)
    vertices = _welded(receiver)[receiver.triangles[triangles]].astype(np.int64)
    start, end = vertices.reshape(-1), vertices[:, [1, 2, 0]].reshape(-1)
    key = np.minimum(start, end) * (int(vertices.max(initial=0)) + 1) + np.maximum(start, end)
    order = np.argsort(key, kind="stable")
    first = np.flatnonzero(np.diff(key[order], prepend=-1))
    uses = np.diff(first, append=len(key))
    pairs = np.stack([order[first[uses == 2]], order[first[uses == 2] + 1]], axis=1)
    pairs = pairs[(start != end)[pairs[:, 0]]]
    side = pairs % 3
    triangle = triangles[pairs // 3]
    ends = np.stack([side, (side + 1) % 3], axis=2)  # corners (E, 2 sides, 2 ends)
    turned = start[pairs[:, 0]] != start[pairs[:, 1]]
    ends[turned, 1] = ends[turned, 1, ::-1]
    elements = element_triangles(receiver)
    normals = _unit(np.asarray(receiver.normals)[elements[triangle[:, :, None], ends]])
    smooth = np.abs(normals[:, 0] - normals[:, 1]).max(axis=(1, 2), initial=0) <= SAME_NORMAL
    places = layout.corners[triangle[:, :, None], ends]
    apart = np.abs(places[:, 0] - places[:, 1]).max(axis=(1, 2), initial=0) > SAME_PLACE
    count = len(receiver.triangles)
    chart, region = (components(triangle[joined], count) for joined in (~apart, smooth & ~apart))
    return Edges(chart, region, places[smooth & apart])


def _welded(receiver: Receiver) -> Index:
    """For each vertex (V,) the number of its position: meshes that were imported have several
    vertices at one place, wherever their UVs or normals differ."""
    positions = np.ascontiguousarray(receiver.vertices, np.float32) + np.float32(0)  # 0 is not -0
    rows = positions.view(np.dtype((np.void, 12))).reshape(-1)
    return np.asarray(np.unique(rows, return_inverse=True)[1]).reshape(-1).astype(np.int64)


def _unit(normals: npt.NDArray[np.float32]) -> Float:
    length = np.linalg.norm(normals, axis=-1, keepdims=True)
    return np.asarray(normals / np.maximum(length, 1e-6), np.float64)
