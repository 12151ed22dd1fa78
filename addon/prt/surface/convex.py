"""Whether a receiver is a convex body, which cannot shadow itself."""

import numpy as np
import numpy.typing as npt

from ..job import Receiver
from .points import element_triangles

Float = npt.NDArray[np.float64]

SLACK = 1e-6  # of the size: what float32 leaves of a flat side
SLACK_OF_AREA = 1e-4
PLANES = 32  # tangent planes that are tried before the edges are looked at
SOME = 1024  # vertices that are held against these before all are


def is_convex(receiver: Receiver) -> bool:
    """Whether the surface is closed and convex and its shading normals keep to it: then nothing of
    it rises above any of its tangent planes.

    A closed surface of one piece without holes is convex where all its edges are and no vertex has
    angles of more than a full turn (Tietze and Nakajima's theorem).
    """
    if len(receiver.triangles) < 4:
        return False
    positions = np.asarray(receiver.vertices, np.float64)
    size = float(np.ptp(positions, axis=0).max())
    if not (
        _holds_below(positions, receiver, size * SLACK)
        and _faces_all_ways(positions[receiver.triangles])
        and _keeps_to_its_faces(positions, receiver, size * SLACK)
    ):
        return False
    places, vertex = np.unique(receiver.vertices, axis=0, return_inverse=True)
    triangles = vertex.reshape(-1)[receiver.triangles]
    corners = places.astype(np.float64)[triangles]
    pairs = _edges(triangles)
    if pairs is None or len(np.unique(triangles)) - len(pairs) + len(triangles) != 2:
        return False
    return _bends_outward(corners, pairs, size * SLACK) and _turns_at_most_once(
        triangles, corners, len(places)
    )


def _sound(normals: npt.NDArray[np.float32]) -> Float:
    """``normals``, of which those that are not sound are 0: such a point takes its face's."""
    return np.nan_to_num(normals.astype(np.float64), posinf=0, neginf=0)


def _holds_below(positions: Float, receiver: Receiver, slack: float) -> bool:
    """Whether all lies below the tangent planes at some of the elements."""
    elements = element_triangles(receiver).reshape(-1)
    chosen = np.linspace(0, elements.size - 1, PLANES).astype(np.int64)
    some = _sound(receiver.normals[elements[chosen]])
    heights = np.einsum("ec,ec->e", some, positions[receiver.triangles.reshape(-1)[chosen]])
    few = positions[:: 1 + len(positions) // SOME]
    return all(
        bool(((some @ places.T).max(axis=1) <= heights + slack).all())
        for places in (few, positions)
    )


def _faces_all_ways(corners: Float) -> bool:
    """Whether the triangles' areas times their normals add up to nothing, as on every closed
    surface."""
    cross = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    return bool(np.abs(cross.sum(axis=0)).max() <= SLACK_OF_AREA * np.abs(cross).sum())


def _keeps_to_its_faces(positions: Float, receiver: Receiver, slack: float) -> bool:
    """Whether what shares a triangle with an element lies below its tangent plane."""
    elements, corners = element_triangles(receiver), positions[receiver.triangles]
    normals = _sound(receiver.normals)
    for k in range(3):
        sides = corners[:, [(k + 1) % 3, (k + 2) % 3]] - corners[:, k, None]
        if (np.einsum("fsc,fc->fs", sides, normals[elements[:, k]]) > slack).any():
            return False
    return True


def _edges(triangles: npt.NDArray[np.int64]) -> npt.NDArray[np.int64] | None:
    """Rows (E, 4): two triangles that share an edge, and in each the corner opposite to it; None
    where some edge has not exactly two triangles, one in each direction."""
    ends = np.concatenate([triangles[:, [1, 2]], triangles[:, [2, 0]], triangles[:, [0, 1]]])
    forward = ends[:, 0] < ends[:, 1]
    if ends.size == 0 or 2 * int(forward.sum()) != len(ends):
        return None
    low, high = ends.min(axis=1), ends.max(axis=1)
    order = np.lexsort((~forward, high, low))
    first, second = order[0::2], order[1::2]
    paired = (low[first] == low[second]) & (high[first] == high[second])
    if not (paired & forward[first] & ~forward[second]).all():
        return None
    if ((np.diff(low[first]) == 0) & (np.diff(high[first]) == 0)).any():
        return None
    count = len(triangles)
    return np.stack([first % count, first // count, second % count, second // count], axis=1)


def _bends_outward(corners: Float, pairs: npt.NDArray[np.int64], slack: float) -> bool:
    """Whether each triangle's opposite corner lies below the plane of its neighbour."""
    cross = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    length = np.linalg.norm(cross, axis=1, keepdims=True)
    normals = cross / np.where(length > 0, length, 1)
    here, there, corner = pairs[:, 0], pairs[:, 2], pairs[:, 3]
    rise = np.einsum("ec,ec->e", corners[there, corner] - corners[here, 0], normals[here])
    return bool((rise <= slack).all())


def _turns_at_most_once(triangles: npt.NDArray[np.int64], corners: Float, vertices: int) -> bool:
    """Whether the angles about every vertex add up to a full turn at most."""
    sides = corners[:, [1, 2, 0]] - corners
    back = -sides[:, [2, 0, 1]]
    cosine = np.einsum("fkc,fkc->fk", sides, back)
    cosine /= np.maximum(np.linalg.norm(sides, axis=2) * np.linalg.norm(back, axis=2), 1e-300)
    angles = np.arccos(np.clip(cosine, -1, 1))
    sums = np.bincount(triangles.reshape(-1), angles.reshape(-1), vertices)
    return bool((sums <= 2 * np.pi + 1e-4).all())
