"""Faces without a material show the bake through a default one, on the object's own slots."""

import bpy

from . import default_surface

KEY = "prt_slots"  # on an object: what its slots were; on a mesh: that its only slot is ours


def has_empty(obj: bpy.types.Object) -> bool:
    """Whether some face of ``obj`` may have no material."""
    slots = obj.material_slots
    return not slots or any(slot.material is None for slot in slots)


def fill(obj: bpy.types.Object) -> None:
    """Put the default material where ``obj`` has none; ``restore`` undoes it."""
    if not has_empty(obj):
        return
    if not obj.material_slots:
        obj.data.materials.append(None)
        obj.data[KEY] = True
    filled = dict(obj.get(KEY, {}))
    for index, slot in enumerate(obj.material_slots):
        if slot.material is None:
            filled[str(index)] = _remember(slot)
            slot.material = default_surface.material()
    obj[KEY] = filled


def restore(obj: bpy.types.Object) -> None:
    """Give ``obj`` the slots that it had; one that the artist has changed since stays his."""
    for index, state in dict(obj.get(KEY, {})).items():
        slot = obj.material_slots[int(index)] if int(index) < len(obj.material_slots) else None
        if slot is not None and slot.material == default_surface.material():
            slot.material = state.get("hidden")
            slot.link = state["link"]
    if KEY in obj:
        del obj[KEY]
    _drop_slot(obj.data)


def _remember(slot: bpy.types.MaterialSlot) -> dict:
    """What the slot was; from here on the object's own material counts, not the mesh's."""
    state = {"link": slot.link}
    slot.link = "OBJECT"
    if slot.material is not None:
        state["hidden"] = slot.material
    return state


def _drop_slot(mesh: bpy.types.Mesh) -> None:
    """Remove the slot that ``fill`` made, with the last object that needs it."""
    needed = any(obj.data == mesh and KEY in obj for obj in bpy.data.objects)
    if KEY in mesh and not needed:
        del mesh[KEY]
        if len(mesh.materials) == 1 and mesh.materials[0] is None:
            mesh.materials.clear()  # pop leaves the slot on the objects
