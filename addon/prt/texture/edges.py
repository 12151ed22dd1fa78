"""Where the surface goes on in the atlas, and the seams, where it goes on elsewhere in it."""

from dataclasses import dataclass

import numpy as np

from ..job import Receiver
from ..surface.edges import components, welded
from ..surface.edges import edges_of as joined_edges
from ..surface.points import Surface
from .cover import Float, Index, Layout

SAME_PLACE = 1e-3  # texels


@dataclass(frozen=True)
class Edges:
    """Of F triangles: the ``chart`` (F,) that each is in, and the ``region`` (F,), a piece of a
    chart over which shading is smooth, both as the number of one of its triangles; and the seams,
    edges of exactly two triangles with equal shading normals that lie apart in the atlas: the ends
    of both of their sides in texels, ``seams`` (S, 2 sides, 2 ends, 2), the same end first, and the
    triangles ``beside`` them (S, 2).  Where the surface folds back on itself, its two sides see
    different things: that is no seam."""

    chart: Index
    region: Index
    seams: Float
    beside: Index


def edges_of(receiver: Receiver, surface: Surface, layout: Layout) -> Edges:
    """The edges between the triangles of ``receiver``, as they lie in ``layout``."""
    edges = joined_edges(receiver, welded(receiver.vertices))
    triangle, side = np.divmod(edges.sides, 3)
    ends = layout.corners[triangle[..., None], np.stack([side, (side + 1) % 3], axis=2)]
    turned = ends.copy()
    turned[:, 1] = ends[:, 1, ::-1]  # a neighbour that is wound alike runs the other way
    apart, otherwise = (
        np.abs(e[:, 0] - e[:, 1]).max(axis=(1, 2), initial=0) > SAME_PLACE for e in (turned, ends)
    )
    count = len(receiver.triangles)
    chart = components(triangle[~(apart & otherwise)], count)
    region = components(triangle[edges.joined & ~apart], count)
    facing = surface.normals[triangle]
    folded = np.einsum("ec,ec->e", facing[:, 0], facing[:, 1]) < 0
    seams = edges.joined & apart & ~folded
    return Edges(chart, region, turned[seams], triangle[seams])
