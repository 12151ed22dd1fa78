"""Objects that share materials: a material shows one layout, and one atlas."""

import bpy

from . import default_slots, default_surface, materials

DEFAULT = "default"  # stands for the material that faces without one will get
Look = bpy.types.Material | str


def looks(obj: bpy.types.Object, depsgraph: bpy.types.Depsgraph) -> set[Look]:
    """The materials that ``obj`` shows once it is baked."""
    found: set[Look] = {
        DEFAULT if default_surface.is_ours(material) else material
        for material in materials.of(obj, depsgraph)
    }
    return found | ({DEFAULT} if default_slots.has_empty(obj) else set())


def groups(objects: list[bpy.types.Object], depsgraph: bpy.types.Depsgraph) -> list[int]:
    """A number for each of ``objects``, the same for those that share a material, or others with
    which they do."""
    number: dict[Look, int] = {}
    found: list[int] = []
    for place, obj in enumerate(objects):
        mine = looks(obj, depsgraph)
        joined = {number[look] for look in mine if look in number}
        found.append(place)
        number |= dict.fromkeys(mine, place)
        number = {look: place if n in joined else n for look, n in number.items()}
        found = [place if n in joined else n for n in found]
    return found


def words(look: Look) -> str:
    """What an artist calls it."""
    if isinstance(look, str):
        return "the default material of faces that have none"
    return f"material {look.name!r}"
