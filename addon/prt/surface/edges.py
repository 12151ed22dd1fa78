"""Which triangles of a receiver meet at an edge, and where shading runs on over it."""

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from ..job import Receiver
from .points import Index, element_triangles

SAME_NORMAL = 1e-3  # length of the difference of unit normals: what rounding leaves


@dataclass(frozen=True)
class Edges:
    """Triangles that meet: ``sides`` (E, 2) are two numbers of half edges, ``3 f + k`` from corner
    k of triangle f to its next one; of an edge with more than two triangles each and the next.
    ``joined`` (E,): the edge has two triangles, wound alike, and equal shading normals on both
    sides."""

    sides: Index
    joined: npt.NDArray[np.bool_]

    @property
    def triangles(self) -> Index:
        """The two triangles (E, 2) of each."""
        return self.sides // 3


def welded(vertices: npt.NDArray[Any]) -> Index:
    """For each vertex (V,) the number of its position among the distinct ones, as float32."""
    bits = np.ascontiguousarray(vertices, np.float32) + np.float32(0)  # 0 is not -0
    order = np.lexsort(bits.view(np.uint32).reshape(-1, 3).T)
    sorted_bits = bits[order]
    is_new = np.ones(len(order), np.int64)
    is_new[1:] = (sorted_bits[1:] != sorted_bits[:-1]).any(axis=1)
    place = np.empty(len(order), np.int64)
    place[order] = np.cumsum(is_new) - 1
    return place


def edges_of(receiver: Receiver, positions: Index) -> Edges:
    """The edges between ``receiver``'s triangles, its vertices being ``positions`` (V,) as
    ``welded`` numbers them."""
    ends = positions[receiver.triangles]
    start, end = ends.reshape(-1), ends[:, [1, 2, 0]].reshape(-1)
    low, high = np.minimum(start, end), np.maximum(start, end)
    halves = np.flatnonzero(low != high)
    key = low[halves] * (int(positions.max(initial=0)) + 1) + high[halves]
    order = np.argsort(key, kind="stable")
    key, halves = key[order], halves[order]
    same = key[1:] == key[:-1]
    two = same.copy()
    two[1:] &= ~same[:-1]
    two[:-1] &= ~same[1:]
    sides = np.stack([halves[:-1], halves[1:]], axis=1)[same]
    joined = two[same] & (start[sides[:, 0]] == end[sides[:, 1]])
    joined[joined] = _equal_normals(receiver, sides[joined])
    return Edges(sides, joined)


def _equal_normals(receiver: Receiver, sides: Index) -> npt.NDArray[np.bool_]:
    """Whether half edges (E, 2) of opposite direction have equal shading normals at both ends."""
    rows = element_triangles(receiver).reshape(-1)
    normals = np.asarray(receiver.normals)
    after = sides - sides % 3 + (sides + 1) % 3
    equal = np.ones(len(sides), bool)
    for here, there in ((sides[:, 0], after[:, 1]), (after[:, 0], sides[:, 1])):
        difference = normals[rows[here]] - normals[rows[there]]
        equal &= np.einsum("ec,ec->e", difference, difference) <= SAME_NORMAL**2
    return equal


def components(edges: Index, count: int) -> Index:
    """The lowest node of each node's connected component (``count``,), by ``edges`` (E, 2)."""
    label = np.arange(count)
    while True:
        low = np.minimum(label[edges[:, 0]], label[edges[:, 1]])
        new = label.copy()
        np.minimum.at(new, label[edges[:, 0]], low)
        np.minimum.at(new, label[edges[:, 1]], low)
        while (new != new[new]).any():
            new = new[new]
        if (new == label).all():
            return label
        edges, label = edges[new[edges[:, 0]] != new[edges[:, 1]]], new
