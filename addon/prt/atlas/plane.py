"""Triangles and groups of them laid into the plane as they are."""

from typing import Any

import numpy as np
import numpy.typing as npt

from ..surface.points import Float, Index

FLAT = 1e-5  # of a group's size: what lies no farther off its plane lies in it
NEEDLE = 1e-5  # height of a triangle over its longest side
FACING = 0.99  # cosine of a triangle's normal to its flat group's


def cross_products(corners: Float) -> Float:
    """Normals (F, 3) of triangles (F, 3, 3), as long as they have area, twice."""
    return np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])


def are_needles(corners: Float) -> npt.NDArray[np.bool_]:
    """Which triangles (F, 3, 3) have no area to speak of: xatlas places no such reliably, and
    nobody sees them."""
    sides = corners - corners[:, [1, 2, 0]]
    longest = np.einsum("fkc,fkc->fk", sides, sides).max(axis=1)
    return np.asarray(np.linalg.norm(cross_products(corners), axis=1) <= NEEDLE * longest)


def plane_areas(uvs: npt.NDArray[Any]) -> Float:
    """Signed areas (F,) of triangles (F, 3, 2); positive where they run anticlockwise."""
    a, b = uvs[:, 1] - uvs[:, 0], uvs[:, 2] - uvs[:, 0]
    return np.asarray(0.5 * (a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]), np.float64)


def are_flat(corners: Float, groups: Index, count: int) -> npt.NDArray[np.bool_]:
    """Whether each of ``count`` groups (F,) of triangles (F, 3, 3) lies in a plane, all of it
    facing the same way."""
    cross = cross_products(corners)
    normals = _unit(sums(cross, groups, count))
    facing = np.einsum("fc,fc->f", _unit(cross), normals[groups]) >= FACING
    weights = np.maximum(np.bincount(groups, minlength=count), 1)[:, None]
    centres = sums(corners.mean(axis=1), groups, count) / weights
    away = corners - centres[groups][:, None]
    height = np.abs(np.einsum("fkc,fc->fk", away, normals[groups])).max(axis=1)
    size = np.zeros(count)
    np.maximum.at(size, groups, np.abs(away).max(axis=(1, 2)))
    flat = np.ones(count, bool)
    flat[groups[~(facing & (height <= FLAT * size[groups]))]] = False
    return flat


def projected(points: Float, normal: Float) -> Float:
    """``points`` (N, 3) seen from where the unit ``normal`` points to, (N, 2)."""
    least = np.zeros(3)
    least[np.abs(normal).argmin()] = 1
    u = _unit(np.cross(least, normal))
    return points @ np.stack([u, np.cross(normal, u)], axis=1)


def unfolded(corners: Float) -> Float:
    """Triangles (F, 3, 3) each in a plane of its own (F, 3, 2): the first corner at 0, the second
    on the first axis, anticlockwise."""
    side, other = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    length = np.linalg.norm(side, axis=1)
    safe = np.where(length > 0, length, 1)
    flat = np.zeros((len(corners), 3, 2))
    flat[:, 1, 0] = length
    flat[:, 2, 0] = np.einsum("fc,fc->f", side, other) / safe
    flat[:, 2, 1] = np.linalg.norm(cross_products(corners), axis=1) / safe
    return flat


def sums(values: Float, groups: Index, count: int) -> Float:
    """Sums (``count``, K) of ``values`` (F, K) over ``groups`` (F,)."""
    columns = [np.bincount(groups, values[:, k], count) for k in range(values.shape[1])]
    return np.stack(columns, axis=1)


def _unit(vectors: Float) -> Float:
    length = np.linalg.norm(vectors, axis=-1, keepdims=True)
    return np.asarray(vectors / np.where(length > 0, length, 1))
