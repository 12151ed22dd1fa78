"""Where rays start: every distinct (position, normal) of a mesh once, just off its surface.

A vertex is a bad place to start from.  It lies on edges that Embree may miss or hit by chance, in
inner corners it lies in the neighbouring walls too, and a wall may stand on a row of vertices.  So
a point moves a hundredth of the way into its *host*, the triangle with the widest angle at that
vertex; then up to the tangent plane of the shading normal where it came to lie below it (Hanika,
Ray Tracing Gems II, ch. 4), so that a smooth convex mesh doesn't shadow itself; and at last off the
surface by a bias that scales with the coordinates' float32 spacing.
"""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from .job import Receiver

Float = npt.NDArray[np.float64]
Index = npt.NDArray[np.int64]

INWARD = 0.01  # share of the way to the host's centroid
BIAS = 2.0**-19  # of the largest coordinate nearby: 16 steps of float32
NORMAL_STEPS = 2**14  # normals closer than one step are one
MIXERS = np.random.default_rng(0).integers(2**63, 2**64, 6, np.uint64) | np.uint64(1)


@dataclass(frozen=True)
class Points:
    """Ray origins (P, 3) float32 in Morton order, unit shading normals (P, 3) float32, and for
    each vertex or corner its point, ``element_points`` (E,) int32, -1 where it has no surface."""

    origins: npt.NDArray[np.float32]
    normals: npt.NDArray[np.float32]
    element_points: npt.NDArray[np.int32]


@dataclass(frozen=True)
class Surface:
    """A receiver's triangles in float64: corner positions (F, 3, 3), unit geometric normals
    (F, 3), and which of them have an area."""

    corners: Float
    normals: Float
    solid: npt.NDArray[np.bool_]
    areas: Float

    @classmethod
    def of(cls, receiver: Receiver) -> "Surface":
        """The surface of ``receiver``."""
        corners = receiver.vertices.astype(np.float64)[receiver.triangles]
        cross = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        double_area = np.sqrt(np.einsum("fc,fc->f", cross, cross))
        solid = double_area > 0
        normals = cross / np.where(solid, double_area, 1)[:, None]
        return cls(corners, normals, solid, 0.5 * double_area)


def element_triangles(receiver: Receiver) -> npt.NDArray[np.int32]:
    """The elements (F, 3) of the receiver's domain at the corners of its triangles."""
    on_points = receiver.domain == "POINT"
    return np.asarray(receiver.triangles if on_points else receiver.triangle_corners)


def distinct_points(receiver: Receiver) -> Points:
    """Every distinct (position, normal) of the elements that belong to a triangle with an area."""
    surface = Surface.of(receiver)
    hosts = _hosts(receiver, surface)
    used = np.flatnonzero(hosts >= 0)
    on_points = receiver.domain == "POINT"
    vertices = used if on_points else np.asarray(receiver.corner_vertices)[used]
    positions = receiver.vertices[vertices]
    normals = _sound_normals(receiver.normals[used], surface.normals[hosts[used]])
    first, point_of_used = _distinct(positions, normals)
    origins = _origins(positions[first], normals[first], surface, hosts[used[first]])
    order = morton_order(origins)
    rank = np.empty(len(order), np.int32)
    rank[order] = np.arange(len(order), dtype=np.int32)
    element_points = np.full(len(receiver.normals), -1, np.int32)
    element_points[used] = rank[point_of_used]
    return Points(
        origins[order].astype(np.float32), normals[first][order].astype(np.float32), element_points
    )


def _hosts(receiver: Receiver, surface: Surface) -> Index:
    """For each element the triangle with the widest angle there, -1 where there is none."""
    sides = surface.corners[:, [1, 2, 0]] - surface.corners  # from each corner to the next
    lengths = np.sqrt(np.einsum("fkc,fkc->fk", sides, sides))
    lengths *= lengths[:, [2, 0, 1]]
    cosine = np.einsum("fkc,fkc->fk", sides, -sides[:, [2, 0, 1]]) / np.where(lengths, lengths, 1)
    cosine[~surface.solid] = np.inf
    elements = element_triangles(receiver)
    widest = np.full(len(receiver.normals), np.inf)
    np.minimum.at(widest, elements.reshape(-1), cosine.reshape(-1))
    is_host = (cosine == widest[elements]) & surface.solid[:, None]
    hosts = np.full(len(receiver.normals), -1, np.int64)
    hosts[elements[is_host]] = np.nonzero(is_host)[0]
    return hosts


def _sound_normals(normals: npt.NDArray[np.float32], geometric: Float) -> Float:
    """Unit normals; the geometric one where the shading normal is none."""
    lengths = np.linalg.norm(normals.astype(np.float64), axis=1, keepdims=True)
    sound = np.isfinite(lengths) & (lengths > 1e-6)
    return np.where(sound, normals / np.where(sound, lengths, 1), geometric)


def _distinct(positions: npt.NDArray[np.float32], normals: Float) -> tuple[Index, Index]:
    """First occurrences (P,) of distinct (position, normal), and each row's place among them."""
    steps = np.rint(normals * NORMAL_STEPS).astype(np.int32)
    keys = np.concatenate(
        [steps, (positions.astype(np.float32) + np.float32(0)).view(np.int32)], axis=1
    )
    mixed = (keys.astype(np.uint64) * MIXERS).sum(axis=1, dtype=np.uint64)
    order = np.argsort(mixed, kind="stable")  # equal keys stand together, which is all it takes
    is_new = np.ones(len(keys), bool)
    is_new[1:] = (keys[order[1:]] != keys[order[:-1]]).any(axis=1)
    place = np.empty(len(keys), np.int64)
    place[order] = np.cumsum(is_new) - 1
    return order[is_new], place


def _origins(
    positions: npt.NDArray[np.float32], normals: Float, surface: Surface, hosts: Index
) -> Float:
    """Positions (P, 3) moved into their hosts, up to the tangent plane and off the surface."""
    start = positions.astype(np.float64)
    corners = surface.corners[hosts]
    inward = corners.mean(axis=1) - start
    bias = surface_bias(corners)
    distance = np.linalg.norm(inward, axis=1, keepdims=True)
    share = np.clip(4 * bias / np.maximum(distance, 1e-300), INWARD, 0.5)
    inside = start + share * inward
    return inside + lift(inside, start, normals) + bias * surface.normals[hosts]


def lift(inside: Float, vertices: Float, normals: Float) -> Float:
    """What takes points (P, 3) that lie below the tangent plane at ``vertices`` up to it."""
    depth = ((inside - vertices) * normals).sum(axis=1, keepdims=True)
    return -np.minimum(depth, 0) * normals


def surface_bias(corners: Float) -> Float:
    """The offset (P, 1) off triangles with ``corners`` (P, 3, 3)."""
    largest = np.maximum.reduce(np.abs(corners).reshape(-1, 9).T.copy())
    return np.asarray(np.maximum(BIAS * largest, 1e-30)[:, None])


def morton_order(positions: Float) -> Index:
    """The order of ``positions`` (P, 3) along a Z curve: neighbours trace the same triangles."""
    if not len(positions):
        return np.zeros(0, np.int64)
    low, high = positions.min(axis=0), positions.max(axis=0)
    extent = max(float((high - low).max()), 1e-300)
    cells = ((positions - low) / extent * (2**20 - 1)).astype(np.uint64)
    code = sum(_spread(cells[:, axis]) << np.uint64(axis) for axis in range(3))
    return np.argsort(code, kind="stable")


def _spread(values: npt.NDArray[np.uint64]) -> npt.NDArray[np.uint64]:
    """The 21 low bits with two zero bits after each."""
    for shift, mask in (
        (32, 0x1F00000000FFFF),
        (16, 0x1F0000FF0000FF),
        (8, 0x100F00F00F00F00F),
        (4, 0x10C30C30C30C30C3),
        (2, 0x1249249249249249),
    ):
        values = (values | (values << np.uint64(shift))) & np.uint64(mask)
    return values
