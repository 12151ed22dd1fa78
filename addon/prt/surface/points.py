"""Where rays start: every distinct (position, normal) of a mesh once, just off its surface.

A vertex is a bad place to start from.  It lies on edges that Embree may miss or hit by chance, in
inner corners it lies in the neighbouring walls too, and a wall may stand on a row of vertices.  So
a point moves a hundredth of the way into its *host*, the triangle with the widest angle at that
vertex; then up to the tangent plane of the shading normal where it came to lie below it (Hanika,
Ray Tracing Gems II, ch. 4), so that a smooth convex mesh doesn't shadow itself; and at last off the
surface by a bias that scales with the coordinates' float32 spacing.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import numpy.typing as npt

from ..job import Receiver
from ..mixing import mixed
from ..slices import slices

Float = npt.NDArray[np.float64]
Index = npt.NDArray[np.int64]
Codes = npt.NDArray[np.uint64]

INWARD = 0.01  # share of the way to the host's centroid
BIAS = 2.0**-19  # of the largest coordinate nearby: 16 steps of float32
PLANE = 2.0**-22  # of a triangle's longest side over its height: 4 steps of float32
SLIVER = 1e-2  # height of a triangle over its longest side
NORMAL_STEPS = 2**14  # normals closer than one step are one
LOW_BITS = np.uint64(0xFFFFFFFF)
PIECE = 1 << 12  # rows: what is made of more is mapped into memory anew each time
ANGLE_STEPS = 2.0**28
NO_HOST = np.int64(2**63 - 1)
MORTON_BITS = 16  # an axis


@dataclass(frozen=True)
class Points:
    """Ray origins (P, 3) float32 in Morton order, unit shading normals (P, 3) float32, and for
    each vertex or corner its point, ``element_points`` (E,) int32, -1 where it has no surface."""

    origins: npt.NDArray[np.float32]
    normals: npt.NDArray[np.float32]
    element_points: npt.NDArray[np.int32]


@dataclass(frozen=True)
class Surface:
    """A receiver's ``vertices`` (V, 3) in float64, the ``triangles`` (F, 3) of these, and their
    ``areas`` (F,)."""

    vertices: Float
    triangles: npt.NDArray[np.int32]
    areas: Float

    @classmethod
    def of(cls, receiver: Receiver) -> "Surface":
        """The surface of ``receiver``, found in pieces that stay in the processor's cache."""
        vertices, triangles = np.asarray(receiver.vertices), np.asarray(receiver.triangles)
        columns, areas = np.ascontiguousarray(vertices.T, np.float64), np.empty(len(triangles))
        for part in slices(len(triangles), PIECE):
            a, b, c = _corners(columns, triangles[part])
            cross = _cross(b - a, c - a)
            areas[part] = 0.5 * np.sqrt(_dot(cross, cross))
        return cls(np.ascontiguousarray(vertices, np.float64), triangles, areas)

    @property
    def solid(self) -> npt.NDArray[np.bool_]:
        """Which triangles (F,) have an area."""
        return self.areas > 0

    @cached_property
    def corners(self) -> Float:
        """The positions (F, 3, 3) of all corners."""
        return self.corners_of(slice(None))

    @cached_property
    def normals(self) -> Float:
        """Unit geometric normals (F, 3) of all triangles, 0 where they have no area."""
        return face_normals(self.corners)

    def corners_of(self, chosen: Index | slice) -> Float:
        """The positions (M, 3, 3) of the corners of the ``chosen`` triangles; not kept."""
        return np.asarray(self.vertices.take(self.triangles[chosen], axis=0))

    def only(self, chosen: npt.NDArray[np.bool_]) -> "Surface":
        """The ``chosen`` (F,) of its triangles."""
        return Surface(self.vertices, self.triangles[chosen], self.areas[chosen])


def face_normals(corners: Float) -> Float:
    """The unit geometric normals (M, 3) of triangles with ``corners`` (M, 3, 3), 0 where they have
    no area."""
    normals = np.empty((len(corners), 3))
    for part in slices(len(corners), PIECE):
        normals[part] = _geometric_normals(np.ascontiguousarray(corners[part].transpose(1, 2, 0))).T
    return normals


def element_triangles(receiver: Receiver) -> npt.NDArray[np.int32]:
    """The elements (F, 3) of the receiver's domain at the corners of its triangles."""
    on_points = receiver.domain == "POINT"
    return np.asarray(receiver.triangles if on_points else receiver.triangle_corners)


def distinct_points(receiver: Receiver) -> Points:
    """Every distinct (position, normal) of the elements that belong to a triangle with an area.

    Coordinates are kept as columns and worked on in pieces that stay in the processor's cache.
    """
    columns = np.ascontiguousarray(np.asarray(receiver.vertices).T, np.float64)
    hosts = _hosts(receiver, columns)
    used = np.flatnonzero(hosts >= 0)
    hosts = hosts[used]
    vertices = used if receiver.domain == "POINT" else np.asarray(receiver.corner_vertices)[used]
    corners = np.ascontiguousarray(receiver.triangles)
    normals = np.empty((3, len(used)), np.float32)
    for part in slices(len(used), PIECE):
        normals[:, part] = _unit_normals(
            receiver, used[part], columns, corners.take(hosts[part], 0)
        )
    positions = np.ascontiguousarray(receiver.vertices, np.float32)
    first, point_of_used = _distinct(positions, vertices, normals)
    normals, origins = normals.take(first, 1), np.empty((3, len(first)), np.float32)
    for part in slices(len(first), PIECE):
        some = first[part]
        its_corners = _corners(columns, corners.take(hosts[some], 0))
        start = columns.take(vertices[some], axis=1)
        origins[:, part] = _origins(start, normals[:, part].astype(np.float64), its_corners)
    order = morton_order(origins.T)
    rank = np.empty(len(order), np.int32)
    rank[order] = np.arange(len(order), dtype=np.int32)
    element_points = np.full(len(receiver.normals), -1, np.int32)
    element_points[used] = rank[point_of_used]
    return Points(
        np.ascontiguousarray(origins.take(order, 1).T),
        np.ascontiguousarray(normals.take(order, 1).T),
        element_points,
    )


def _corners(columns: Float, triangles: npt.NDArray[np.int32]) -> list[Float]:
    """The three corners (3, F) of ``triangles`` (F, 3) of vertices (3, V)."""
    return [columns.take(triangles[:, k], axis=1) for k in range(3)]


def _dot(a: Float, b: Float) -> Float:
    """Products (F) of columns (3, F)."""
    return np.asarray(a[0] * b[0] + a[1] * b[1] + a[2] * b[2])


def _cross(a: Float, b: Float) -> Float:
    """Products (3, F) of columns (3, F)."""
    return np.stack([a[i - 2] * b[i - 1] - a[i - 1] * b[i - 2] for i in range(3)])


def _hosts(receiver: Receiver, columns: Float) -> Index:
    """For each element the triangle with the widest angle there, the first of equals; -1 where
    there is none."""
    elements = element_triangles(receiver)
    widest = np.full(len(receiver.normals), NO_HOST)
    for part in slices(len(elements), PIECE):
        a, b, c = _corners(columns, np.asarray(receiver.triangles[part]))
        sides = (b - a, c - b, a - c)
        square = [_dot(side, side) for side in sides]
        cross = _cross(sides[0], sides[1])
        solid = cross.any(axis=0)
        longest = np.maximum(np.maximum(square[0], square[1]), square[2])
        sliver = _dot(cross, cross) < np.square(SLIVER * longest)  # a host only where none else is
        number = np.arange(part.start, part.stop)
        for k in range(3):
            along = -_dot(sides[k], sides[k - 1])
            with np.errstate(invalid="ignore", divide="ignore"):
                cosine = along * np.abs(along) / (square[k] * square[k - 1])  # squared, its sign
            step = ((np.where(solid, cosine, 0) + 1 + 2 * sliver) * ANGLE_STEPS).astype(np.int64)
            keys = np.where(solid, step << 32 | number, NO_HOST)
            np.minimum.at(widest, elements[part, k], keys)
    return np.where(widest == NO_HOST, -1, widest & 0xFFFFFFFF)


def _unit_normals(
    receiver: Receiver, elements: Index, columns: Float, triangles: npt.NDArray[np.int32]
) -> Float:
    """Unit shading normals (3, E) of ``elements``; where one has none, that of its host of
    ``triangles`` (E, 3)."""
    normals = np.asarray(receiver.normals)[elements].T.astype(np.float64)
    lengths = np.sqrt(_dot(normals, normals))
    with np.errstate(invalid="ignore"):
        normals /= np.where(lengths > 1e-6, lengths, 1)
    missing = np.flatnonzero(~((lengths > 1e-6) & np.isfinite(lengths)))
    if len(missing):
        normals[:, missing] = _geometric_normals(_corners(columns, triangles[missing]))
    return normals


def _geometric_normals(corners: Sequence[Float] | Float) -> Float:
    """Unit normals (3, F) of triangles, 0 where they have no area."""
    cross = _cross(corners[1] - corners[0], corners[2] - corners[0])
    double_area = np.sqrt(_dot(cross, cross))
    return np.asarray(cross / np.where(double_area > 0, double_area, 1))


def _distinct(
    positions: npt.NDArray[np.float32], vertices: Index, normals: npt.NDArray[np.float32]
) -> tuple[Index, Index]:
    """First occurrences (P,) of distinct (position of a vertex, normal), and each one's place among
    them."""
    keys = np.empty((3, len(vertices)), np.uint64)
    for part in slices(len(vertices), PIECE):
        bits = (positions.take(vertices[part], 0) + np.float32(0)).view(np.uint32)  # 0 is not -0
        steps = np.rint(normals[:, part] * NORMAL_STEPS).astype(np.int64).astype(np.uint64)
        keys[0, part] = bits[:, 0].astype(np.uint64) << np.uint64(32) | bits[:, 1]
        keys[1, part] = bits[:, 2].astype(np.uint64) << np.uint64(32) | steps[0] & LOW_BITS
        keys[2, part] = steps[1] << np.uint64(32) | steps[2] & LOW_BITS
    whole = mixed(keys)
    order = np.argsort(whole)  # equal keys stand together, which is all it takes
    is_new = np.ones(len(order), bool)
    is_new[1:] = np.diff(whole[order]) != 0
    for key in keys:  # what mixes alike may still differ
        is_new[1:] |= np.diff(key[order]) != 0
    starts = np.flatnonzero(is_new)
    first = np.minimum.reduceat(order, starts) if len(starts) else starts
    is_first = np.zeros(len(order), bool)
    is_first[first] = True
    place = np.empty(len(order), np.int64)
    place[order] = (np.cumsum(is_first) - 1)[first].take(np.cumsum(is_new) - 1)
    return np.flatnonzero(is_first), place


def _origins(start: Float, normals: Float, corners: list[Float]) -> Float:
    """Vertices (3, P) moved into their hosts, up to the tangent plane and off the surface."""
    inward = (corners[0] + corners[1] + corners[2]) / 3 - start
    bias = _bias(corners)
    distance = np.sqrt(_dot(inward, inward))
    inward *= np.clip(4 * bias / np.maximum(distance, 1e-300), INWARD, 0.5)
    depth = np.minimum(_dot(inward, normals), 0)
    return np.asarray(start + inward - depth * normals + bias * _geometric_normals(corners))


def _bias(corners: list[Float]) -> Float:
    """The offset (F) off triangles: some steps of float32 of their coordinates, and off a sliver as
    far as Embree may misplace its plane, whose normal cancels to the height's share of a side."""
    largest = np.maximum.reduce([np.abs(corner).max(axis=0) for corner in corners])
    sides = [corners[k - 2] - corners[k] for k in range(3)]
    square = np.maximum.reduce([_dot(side, side) for side in sides])
    cross = _cross(sides[0], sides[1])
    double_area = np.maximum(np.sqrt(_dot(cross, cross)), 1e-300)
    steps = np.minimum(PLANE * square / double_area, INWARD)  # of the longest side
    return np.asarray(np.maximum(np.maximum(BIAS * largest, steps * np.sqrt(square)), 1e-30))


def lift(inside: Float, vertices: Float, normals: Float) -> Float:
    """What takes points (P, 3) that lie below the tangent plane at ``vertices`` up to it."""
    depth = ((inside - vertices) * normals).sum(axis=1, keepdims=True)
    return -np.minimum(depth, 0) * normals


def surface_bias(corners: Float) -> Float:
    """The offset (P, 1) off triangles with ``corners`` (P, 3, 3)."""
    return _bias([np.ascontiguousarray(corners[:, k].T) for k in range(3)])[:, None]


def morton_order(positions: npt.NDArray[np.floating[Any]]) -> Index:
    """The order of ``positions`` (P, 3) along a Z curve: neighbours trace the same triangles.

    Code and place are sorted as one number, of which the place takes as many bits as it needs.
    """
    count = len(positions)
    if not count:
        return np.zeros(0, np.int64)
    place_bits = max(1, count.bit_length())
    axis_bits = min(MORTON_BITS, (64 - place_bits) // 3)
    low = positions.min(axis=0)
    extent = float((positions.max(axis=0) - low).max())
    steps = ((1 << axis_bits) - 1) / extent if extent > 0 else 0.0
    cells = (((positions[:, axis] - low[axis]) * steps).astype(np.int32) for axis in range(3))
    code = interleaved(cells, axis_bits) << np.uint64(place_bits)
    code |= np.arange(count, dtype=np.uint64)
    code.sort()
    return (code & np.uint64((1 << place_bits) - 1)).astype(np.int64)


def interleaved(cells: Iterable[npt.NDArray[np.integer[Any]]], bits: int) -> Codes:
    """Places (N,) along a Z curve of ``cells`` of so many ``bits``, (N,) along each axis."""
    columns = list(cells)
    if len(columns[0]) < 1 << bits:
        spread = [_spread(its.astype(np.uint64)) for its in columns]
    else:  # as a table
        table = _spread(np.arange(1 << bits, dtype=np.uint64))
        spread = [table.take(its) for its in columns]
    codes = [its << np.uint64(axis) for axis, its in enumerate(spread)]
    return np.asarray(codes[0] | codes[1] | codes[2])


def _spread(values: Codes) -> Codes:
    """The 16 low bits with two zero bits after each."""
    for shift, mask in (
        (16, 0xFF0000FF),
        (8, 0xF00F00F00F),
        (4, 0xC30C30C30C3),
        (2, 0x249249249249),
    ):
        values = (values | (values << np.uint64(shift))) & np.uint64(mask)
    return values
