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


def filled(obj: bpy.types.Object) -> frozenset[str]:
    """The indices of the slots that ``fill`` has filled."""
    return frozenset(obj.get(KEY, {}).keys())


def restore(obj: bpy.types.Object, but: frozenset[str] = frozenset()) -> None:
    """Give ``obj`` the slots that it had, all ``but`` some; one that the artist has changed since
    stays his."""
    states = dict(obj.get(KEY, {}))
    for index in states.keys() - but:
        state = states.pop(index)
        slot = obj.material_slots[int(index)] if int(index) < len(obj.material_slots) else None
        if slot is not None and slot.material == default_surface.material():
            slot.material = state.get("hidden")
            slot.link = state["link"]
    if states:
        obj[KEY] = states
    elif KEY in obj:
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
    users = [obj for obj in bpy.data.objects if obj.data == mesh]
    if KEY not in mesh or any(KEY in obj for obj in users):
        return
    del mesh[KEY]
    if all(len(obj.material_slots) == 1 and has_empty(obj) for obj in users):
        mesh.materials.clear()  # pop would leave the slot on the objects
