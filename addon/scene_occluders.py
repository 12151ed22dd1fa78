"""All that stands in the light's way, as arrays: one part for each object or instance."""

from collections import Counter
from dataclasses import dataclass

import bpy
import numpy as np

from . import scene_meshes as meshes
from .prt.job import Array
from .scene_visibility import Rendered


@dataclass(frozen=True)
class Occluders:
    """World space: ``vertices`` (V, 3) float64 and ``triangles`` (F, 3) int32; part k, which is an
    object or an instance, is the triangles from ``starts[k]`` to ``starts[k + 1]``, (O + 1,) int64.
    ``repairs``: how many triangles were left out, by reason."""

    vertices: Array
    triangles: Array
    starts: Array
    repairs: dict[str, int]


@dataclass(frozen=True)
class _Mesh:
    """A mesh in its own space, whatever the number of its instances: vertices (V, 3) float32, the
    triangles (F, 3) int32 that can stop light, and how many cannot, by reason."""

    vertices: Array
    triangles: Array
    repairs: Counter[str]


def read(depsgraph: bpy.types.Depsgraph) -> Occluders:
    """All that stops light.  No part is without triangles, and none shares a vertex with another.

    Curves, texts, surfaces and metaballs are there too: the depsgraph lists each a second time, as
    an instance of the mesh that it makes.
    """
    rendered = Rendered(depsgraph.view_layer)
    known: dict[int, _Mesh] = {}
    vertices, triangles, start = [np.empty((0, 3))], [np.empty((0, 3), np.int32)], 0
    repairs = Counter(dropped_triangles=0, zero_area_triangles=0)
    for instance in depsgraph.object_instances:
        if instance.object.type != "MESH" or not rendered.casts_shadow(instance):
            continue
        key = instance.object.data.as_pointer()
        if key not in known:
            known[key] = _read_mesh(instance.object)
        mesh, matrix = known[key], instance.matrix_world
        repairs.update(mesh.repairs)
        if not meshes.placed(np.array(matrix)).all():
            repairs["dropped_triangles"] += len(mesh.triangles)
        elif len(mesh.triangles):
            vertices.append(meshes.to_world(mesh.vertices, matrix))
            triangles.append(meshes.outward(mesh.triangles, matrix) + np.int32(start))
            start += len(mesh.vertices)
    starts = np.cumsum([len(part) for part in triangles], dtype=np.int64)
    return Occluders(np.concatenate(vertices), np.concatenate(triangles), starts, dict(repairs))


def _read_mesh(obj: bpy.types.Object) -> _Mesh:
    """The mesh of an evaluated object.  From ``to_mesh`` and not from its data, because a
    subdivision that the GPU does is only in the former."""
    mesh = obj.to_mesh()
    vertices = meshes.positions(mesh)
    triangles = meshes.corner_vertices(mesh)[meshes.triangle_corners(mesh)]
    obj.to_mesh_clear()
    placed = meshes.placed(vertices)
    vertices[~placed] = 0
    finite = triangles[placed[triangles].all(axis=1)]
    solid = finite[meshes.solid(vertices, finite)]
    dropped, flat = len(triangles) - len(finite), len(finite) - len(solid)
    return _Mesh(vertices, solid, Counter(dropped_triangles=dropped, zero_area_triangles=flat))
