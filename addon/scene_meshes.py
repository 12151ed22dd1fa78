"""Arrays out of Blender's meshes, and their way into the world.

Local arrays are Blender's own float32; world positions are float64, so that they can be re-centred
before they become float32 again.
"""

from typing import Any

import bpy
import numpy as np
import numpy.typing as npt
from mathutils import Matrix

Array = npt.NDArray[Any]
Collection = Any  # a bpy_prop_collection: it has no type of its own to name

READERS = {
    "FLOAT_VECTOR": ("vector", 3, np.float32),
    "INT": ("value", 1, np.int32),
    "BOOLEAN": ("value", 1, np.bool_),
}
FARTHEST = 1e12  # metres; a float32 tracer multiplies three coordinates
FLATTEST = 1e-7  # height of a triangle over its longest edge: float32 tells no more apart


def _read(collection: Collection, name: str, width: int, dtype: type) -> Array:
    """Property ``name`` of every item, (N, width), or (N,) where ``width`` is 1."""
    values = np.empty(len(collection) * width, dtype)
    collection.foreach_get(name, values)
    return values.reshape(-1, width) if width > 1 else values


def attribute(mesh: bpy.types.Mesh, name: str) -> Array:
    """The values of an attribute, no rows where the mesh has none of that name.  20 times faster
    than the same numbers read from the vertices."""
    found = mesh.attributes.get(name)
    if found is None:
        return np.empty(0, np.int32)
    return _read(found.data, *READERS[found.data_type])


def positions(mesh: bpy.types.Mesh) -> Array:
    """Vertices (V, 3) float32, local."""
    return attribute(mesh, "position").reshape(-1, 3)


def corner_vertices(mesh: bpy.types.Mesh) -> Array:
    """The vertex of every corner, (C,) int32."""
    return attribute(mesh, ".corner_vert")


def triangle_corners(mesh: bpy.types.Mesh) -> Array:
    """Blender's triangulation as corners, (F, 3) int32."""
    corners = len(mesh.loops)
    if corners == 3 * len(mesh.polygons):
        return np.arange(corners, dtype=np.int32).reshape(-1, 3)
    mesh.calc_loop_triangles()
    return _read(mesh.loop_triangles, "loops", 3, np.int32)


def vertex_normals(mesh: bpy.types.Mesh) -> Array:
    """Shading normals (V, 3) float32, local."""
    return _read(mesh.vertex_normals, "vector", 3, np.float32)


def corner_normals(mesh: bpy.types.Mesh) -> Array:
    """Shading normals (C, 3) float32, local; flat, sharp and custom ones included."""
    return _read(mesh.corner_normals, "vector", 3, np.float32)


def to_world(vertices: Array, matrix: Matrix) -> Array:
    """Local ``vertices`` (V, 3) in world space, float64."""
    m = np.array(matrix)
    with np.errstate(invalid="ignore", over="ignore"):
        return np.asarray(vertices.astype(np.float64) @ m[:3, :3].T + m[:3, 3])


def mirrors(matrix: Matrix) -> bool:
    """Whether ``matrix`` turns a mesh inside out."""
    return bool(np.linalg.det(np.array(matrix, np.float64)[:3, :3]) < 0)


def outward(corners: Array, matrix: Matrix) -> Array:
    """Triangles (F, 3) wound so that in the world their geometric normal still points out."""
    return np.ascontiguousarray(corners[:, ::-1]) if mirrors(matrix) else corners


def normals_to_world(normals: Array, matrix: Matrix) -> Array:
    """Local unit ``normals`` (N, 3) in world space, float32, unit, pointing out of mirrored meshes
    too.  By cofactors, which are the inverse transpose where there is one and exist where an axis
    is scaled to nothing; in float64, because their squares leave float32 at a scale of 1e10."""
    x, y, z = np.array(matrix, np.float64)[:3, :3].T
    cofactors = np.stack([np.cross(y, z), np.cross(z, x), np.cross(x, y)])
    turned = normals @ (-cofactors if mirrors(matrix) else cofactors)
    length = np.linalg.norm(turned, axis=1, keepdims=True)
    unit = np.divide(turned, length, out=np.zeros_like(turned), where=length > 0)
    unit[length[:, 0] == 0] = (0, 0, 1)
    return unit.astype(np.float32)


def placed(vertices: Array) -> Array:
    """Which world ``vertices`` (V, 3) are at a place that can be traced: (V,) bool."""
    return np.asarray((np.abs(vertices) < FARTHEST).all(axis=1))


def solid(vertices: Array, triangles: Array) -> Array:
    """Which ``triangles`` have an area worth the name: (F,) bool.  By Lagrange's identity: a
    cross product takes five times as long."""
    first = vertices[triangles[:, 0]].astype(np.float64)
    u, v = vertices[triangles[:, 1]] - first, vertices[triangles[:, 2]] - first
    uu, vv, uv = (np.einsum("fk,fk->f", *pair) for pair in ((u, u), (v, v), (u, v)))
    longest = np.maximum(np.maximum(uu, vv), uu + vv - 2 * uv)
    return np.asarray(uu * vv - uv * uv > np.square(FLATTEST * longest))
