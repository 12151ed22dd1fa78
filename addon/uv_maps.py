"""The UV map *PRT* that an atlas is laid out by: ours, or the artist's own where he has made one.

A map is ours where the mesh says so and nobody has edited it since; all others are the artist's.
A mesh without any gets an empty one too, which stands before ours: what reads a mesh's first map,
as textures do that nothing is plugged into, goes on to find zeros.
"""

import hashlib

import bpy
import numpy as np
import numpy.typing as npt

NAME = "PRT"
EMPTY = "PRT Empty"
TAG = "prt_uv"  # on a mesh: what our map is
MOST = 8  # UV maps that a mesh of Blender 4 can have

Uvs = npt.NDArray[np.float32]


def read(mesh: bpy.types.Mesh, name: str = NAME) -> Uvs | None:
    """The map (C, 2) ``name`` of ``mesh``; None where it has none."""
    found = mesh.attributes.get(name)
    if found is None or found.domain != "CORNER" or found.data_type != "FLOAT2":
        return None
    values = np.empty(2 * len(found.data), np.float32)
    found.data.foreach_get("vector", values)
    return values.reshape(-1, 2)


def is_ours(mesh: bpy.types.Mesh) -> bool:
    """Whether the map of ``mesh`` is as a bake has written it."""
    if TAG not in mesh:
        return False
    uvs = read(mesh)
    return uvs is not None and mesh[TAG] == digest(uvs)


def has_empty(mesh: bpy.types.Mesh) -> bool:
    """Whether ``mesh`` has the empty map, and nobody has filled it."""
    uvs = read(mesh, EMPTY)
    return uvs is not None and not uvs.any()


def has_others(mesh: bpy.types.Mesh) -> bool:
    """Whether ``mesh`` has UV maps beside these two."""
    return any(layer.name not in {NAME, EMPTY} for layer in mesh.uv_layers)


def digest(uvs: Uvs) -> str:
    """Names a map."""
    return hashlib.sha256(np.ascontiguousarray(uvs, np.float32)).hexdigest()[:16]


def can_take(mesh: bpy.types.Mesh) -> bool:
    """Whether there is room for our map."""
    others = sum(layer.name not in {NAME, EMPTY} for layer in mesh.uv_layers)
    return others < MOST or bpy.app.version >= (5, 0)
