"""Which bakes a button is about: the selected ones, or all of the scene when none is selected."""

import bpy

from . import light_state, stamp


def baked_objects(context: bpy.types.Context) -> list[bpy.types.Object]:
    """The selected baked objects, else every baked object of the scene."""
    selected = [obj for obj in context.selected_objects if stamp.KEY in obj]
    return selected or stamp.baked_objects(context.scene)


def stamps(names: list[str]) -> list[stamp.Stamp]:
    """The stamps of the objects called ``names``, as far as they are there."""
    objects = (bpy.data.objects.get(name) for name in names)
    found = (stamp.read(obj) for obj in objects if obj is not None)
    return [one for one in found if one is not None]


def nothing_baked(scene: bpy.types.Scene) -> str | None:
    """Why nothing can be done with the bakes of ``scene``; None where there are some."""
    if light_state.KEY in scene:
        return None
    return "Nothing is baked in this scene yet: press Bake PRT first"
