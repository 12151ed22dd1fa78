"""The diffuse colour of a mesh whose materials no reading can tell, baked by Cycles to its corners.

In a scene of its own, which is gone afterwards.
"""

import hashlib

import bpy
import numpy as np

from . import cache_folder, tree_digest
from .prt.cache import Cache
from .prt.digests import add_array
from .prt.errors import BakeError
from .prt.job import Array
from .scene_meshes import corner_vertices, positions

NAME = "PRT Albedo"
SAMPLES = 16


def bake(obj: bpy.types.Object, depsgraph: bpy.types.Depsgraph) -> Array:
    """Diffuse colour (C, 3) float32, linear, at every corner of the evaluated mesh of ``obj``: from
    the cache, or baked."""
    before = _everything()
    try:
        mesh = bpy.data.meshes.new_from_object(
            obj, preserve_all_data_layers=True, depsgraph=depsgraph
        )
        cache, key = Cache(cache_folder.path()), _key(mesh, obj)
        known = cache.get(key)
        if known is None:
            colors = _baked(mesh, obj)
            cache.put(key, {"albedo": colors}, {})
            return colors
        return np.array(known.arrays["albedo"])
    finally:
        bpy.data.batch_remove(_everything() - before)


def _key(mesh: bpy.types.Mesh, obj: bpy.types.Object) -> str:
    """Names the colours: by the mesh, its layers, where it is and its materials."""
    digest = hashlib.blake2b(digest_size=20)
    digest.update(repr(tuple(map(tuple, obj.matrix_world))).encode())
    add_array(digest, "positions", positions(mesh))
    add_array(digest, "corners", corner_vertices(mesh))
    for layer in mesh.uv_layers:
        values = np.empty(len(layer.uv) * 2, np.float32)
        layer.uv.foreach_get("vector", values)
        add_array(digest, layer.name + " active" * layer.active_render, values)
    for attribute in mesh.color_attributes:
        values = np.empty(len(attribute.data) * 4, np.float32)
        attribute.data.foreach_get("color", values)
        add_array(digest, attribute.name, values)
    for slot in obj.material_slots:
        digest.update(tree_digest.of(slot.material))
    return f"albedo-{digest.hexdigest()}"


def _baked(mesh: bpy.types.Mesh, obj: bpy.types.Object) -> Array:
    layer = mesh.color_attributes.new(NAME, "FLOAT_COLOR", "CORNER")
    mesh.color_attributes.active_color = layer
    stand_in = bpy.data.objects.new(NAME, mesh)
    for slot, its in zip(stand_in.material_slots, obj.material_slots, strict=False):
        slot.link = "OBJECT"
        slot.material = its.material.original if its.material else None
    stand_in.matrix_world = obj.matrix_world
    studio = bpy.data.scenes.new(NAME)
    studio.collection.objects.link(stand_in)
    _set_up(studio)
    view_layer = studio.view_layers[0]
    view_layer.objects.active = stand_in
    stand_in.select_set(True, view_layer=view_layer)
    with bpy.context.temp_override(
        scene=studio,
        view_layer=view_layer,
        object=stand_in,
        active_object=stand_in,
        selected_objects=[stand_in],
    ):
        bpy.ops.object.bake(type="DIFFUSE", pass_filter={"COLOR"}, target="VERTEX_COLORS")
    values = np.empty(len(mesh.loops) * 4, np.float32)
    mesh.color_attributes[NAME].data.foreach_get("color", values)
    return np.ascontiguousarray(values.reshape(-1, 4)[:, :3])


def _set_up(studio: bpy.types.Scene) -> None:
    try:
        studio.render.engine = "CYCLES"
    except TypeError as error:
        raise BakeError(
            "A material's colour has to be baked for its bounces: enable the add-on Cycles"
        ) from error
    studio.cycles.samples = SAMPLES
    studio.cycles.use_adaptive_sampling = False
    studio.render.bake.use_clear = True


def _everything() -> set[bpy.types.ID]:
    kinds = ("scenes", "meshes", "objects", "linestyles")
    return {block for kind in kinds for block in getattr(bpy.data, kind)}
