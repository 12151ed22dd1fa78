"""Taking bakes away again, so that the file is what it was."""

import bpy

from . import (
    albedo_state,
    atlas_images,
    attributes,
    carrier,
    default_slots,
    default_surface,
    light_state,
    materials,
    nodes,
    reflections,
    stamp,
)


def remove(scene: bpy.types.Scene, objects: list[bpy.types.Object]) -> int:
    """Restore ``objects`` and whatever no bake needs any more; returns how many were baked."""
    baked = [obj for obj in objects if stamp.KEY in obj]
    for obj in baked:
        stamp.remove(obj)
        carrier.disconnect(obj)
        default_slots.restore(obj)
    for mesh in {obj.data for obj in baked}:
        if not _shown(mesh):
            attributes.remove(mesh)
    _free_materials(scene)
    carrier.free_unused()
    nodes.free_unused()
    atlas_images.free_unused()
    reflections.free_unused()
    default_surface.free_unused()
    albedo_state.forget(scene)
    if not stamp.baked_objects(scene):
        light_state.remove(scene)
    return len(baked)


def _shown(mesh: bpy.types.Mesh) -> bool:
    """Whether a baked object still shows the values on ``mesh``."""
    users = (obj for obj in bpy.data.objects if obj.data == mesh)
    return any(s is not None and not s.by_modifier for s in map(stamp.read, users))


def _free_materials(scene: bpy.types.Scene) -> None:
    """Detach every material that no baked object shows."""
    depsgraph = carrier.depsgraph_of(scene)
    baked = (obj for obj in bpy.data.objects if stamp.KEY in obj)
    needed = {material for obj in baked for material in materials.of(obj, depsgraph)}
    for material in materials.attached():
        if material not in needed:
            materials.detach(material)
