"""All that stands in the light's way, as arrays: one part for each object or instance."""

from collections import Counter
from dataclasses import dataclass, field

import bpy
import numpy as np

from . import albedo_state
from . import scene_meshes as meshes
from .prt.job import Array
from .scene_albedo import Albedos, Read
from .scene_visibility import Rendered


@dataclass(frozen=True)
class Occluders:
    """World space: ``vertices`` (V, 3) float64 and ``triangles`` (F, 3) int32; part k, which is an
    object or an instance, is the triangles from ``starts[k]`` to ``starts[k + 1]``, (O + 1,) int64.
    ``repairs``: how many triangles were left out, by reason.  ``albedo`` (F, 3, 3) float32 at the
    corners of the triangles, no rows where it was not asked for, ``emitters``, the names of objects
    that shine by themselves, and ``reflecting``, what names the colours of each object."""

    vertices: Array
    triangles: Array
    starts: Array
    repairs: dict[str, int]
    albedo: Array
    emitters: tuple[str, ...] = ()
    reflecting: albedo_state.Digests = field(default_factory=dict)


@dataclass(frozen=True)
class _Mesh:
    """A mesh in its own space, whatever the number of its instances: vertices (V, 3) float32, the
    triangles (F, 3) int32 that can stop light, how many cannot, by reason, and their albedo."""

    obj: bpy.types.Object
    vertices: Array
    triangles: Array
    repairs: Counter[str]
    albedo: Read | None


def read(depsgraph: bpy.types.Depsgraph, with_albedo: bool = False) -> Occluders:
    """All that stops light.  No part is without triangles, and none shares a vertex with another.

    Curves, texts, surfaces and metaballs are there too: the depsgraph lists each a second time, as
    an instance of the mesh that it makes.
    """
    rendered = Rendered(depsgraph.view_layer)
    albedos = Albedos() if with_albedo else None
    known: dict[tuple[int, ...], _Mesh] = {}
    vertices, triangles, start = [np.empty((0, 3))], [np.empty((0, 3), np.int32)], 0
    shown: list[tuple[_Mesh, bool]] = []
    repairs = Counter(dropped_triangles=0, zero_area_triangles=0)
    for instance in depsgraph.object_instances:
        if instance.object.type != "MESH" or not rendered.casts_shadow(instance):
            continue
        key = _key(instance.object, with_albedo)
        if key not in known:
            known[key] = _read_mesh(instance.object, albedos)
        mesh, matrix = known[key], instance.matrix_world
        repairs.update(mesh.repairs)
        if not meshes.placed(np.array(matrix)).all():
            repairs["dropped_triangles"] += len(mesh.triangles)
        elif len(mesh.triangles):
            vertices.append(meshes.to_world(mesh.vertices, matrix))
            triangles.append(meshes.outward(mesh.triangles, matrix) + np.int32(start))
            start += len(mesh.vertices)
            shown.append((mesh, meshes.mirrors(matrix)))
    starts = np.cumsum([len(part) for part in triangles], dtype=np.int64)
    whole = np.concatenate(vertices), np.concatenate(triangles)
    emitters = tuple(albedos.emitters) if albedos else ()
    reflecting = albedo_state.of({mesh.obj for mesh, _ in shown} if with_albedo else ())
    found = _albedo(shown, depsgraph)
    return Occluders(*whole, starts, dict(repairs), found, emitters, reflecting)


def _key(obj: bpy.types.Object, with_albedo: bool) -> tuple[int, ...]:
    """What an instance shares with others: its mesh, and its materials where they matter."""
    slots = obj.material_slots if with_albedo else ()
    materials = (slot.material.as_pointer() if slot.material else 0 for slot in slots)
    return (obj.data.as_pointer(), *materials)


def _albedo(shown: list[tuple[_Mesh, bool]], depsgraph: bpy.types.Depsgraph) -> Array:
    """Of every part that is ``shown``, some of them mirrored: their corners stand the other way
    round."""
    parts = [np.empty((0, 3, 3), np.float32)]
    baked: set[int] = set()
    for mesh, mirrored in shown:
        if mesh.albedo is None:
            continue
        if id(mesh) not in baked:
            baked.add(id(mesh))
            mesh.albedo.bake(mesh.obj.evaluated_get(depsgraph), depsgraph)
        parts.append(mesh.albedo.albedo[:, ::-1] if mirrored else mesh.albedo.albedo)
    return np.concatenate(parts)


def _read_mesh(obj: bpy.types.Object, albedos: Albedos | None) -> _Mesh:
    """The mesh of an evaluated object.  From ``to_mesh`` and not from its data, because a
    subdivision that the GPU does is only in the former."""
    mesh = obj.to_mesh()
    vertices, corners = meshes.positions(mesh), meshes.triangle_corners(mesh)
    triangles = meshes.corner_vertices(mesh)[corners]
    albedo = albedos.of(obj, mesh, corners) if albedos else None
    obj.to_mesh_clear()
    placed = meshes.placed(vertices)
    vertices[~placed] = 0
    finite = placed[triangles].all(axis=1)
    solid = finite & meshes.solid(vertices, triangles)
    dropped, flat = np.count_nonzero(~finite), np.count_nonzero(finite & ~solid)
    repairs = Counter(dropped_triangles=int(dropped), zero_area_triangles=int(flat))
    kept = albedo[solid] if albedo else None
    return _Mesh(obj.original, vertices, triangles[solid], repairs, kept)
