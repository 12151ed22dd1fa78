"""What could not be written or shown is refused before anything is baked."""

from collections.abc import Iterable, Sequence

import bpy

from . import (
    carrier,
    default_slots,
    material_attributes,
    material_samplers,
    materials,
    sharing,
    stamp,
    uv_maps,
)
from .prt import layout as layouts
from .prt.errors import BakeError
from .prt.layout import Layout

LIMITS = {f"CLAMP_{size}": size for size in (8192, 4096, 2048, 1024, 512, 256, 128)}


def check(
    scene: bpy.types.Scene,
    objects: list[bpy.types.Object],
    layout: Layout,
    least: Layout | None = None,
    carriers: Sequence[str] = (),
    *,
    reflections: bool = False,
) -> None:
    """Refuse, before anything is baked, what could not be written or shown afterwards.

    ``layout`` is the most that will be stored, ``least`` the least, where that is not yet known.
    ``carriers``, one an object, are "vertex", "texture" or "auto"; by default all are vertices.
    With ``reflections`` shiny materials read a texture more.
    """
    carriers = carriers or ["vertex"] * len(objects)
    if any(one != "texture" for one in carriers):
        layouts.check(layout)
    depsgraph = carrier.depsgraph_of(scene)
    for obj, its_carrier in zip(objects, carriers, strict=True):
        for material in materials.of(obj, depsgraph):
            if material.library is not None:
                raise BakeError(
                    f"Material {material.name!r} of {obj.name!r} is linked from another file: "
                    "make it local, or give the object a material of this file"
                )
            if its_carrier != "texture":
                layouts.check(layout, len(material_attributes.of(material)), material.name)
            shiny = reflections and materials.reflects(material)
            if its_carrier != "vertex":
                _check_texture(material)
            _check_samplers(material, (its_carrier != "vertex") + shiny)
        if its_carrier != "vertex" and not uv_maps.can_take(obj.data):
            raise BakeError(
                f"{obj.name!r} has {uv_maps.MOST} UV maps already, and the bake needs one: "
                "delete one that is not used"
            )
    _check_shared(objects, (least or layout, layout), carriers, depsgraph)


def reflects(scene: bpy.types.Scene, objects: list[bpy.types.Object], *, wanted: bool) -> bool:
    """Whether a bake of ``objects`` has to prepare reflections: for shiny materials of theirs,
    where they are ``wanted``, or because other bakes, which the new light falls on too, have some.
    """
    depsgraph = carrier.depsgraph_of(scene)
    theirs = materials_of(objects, depsgraph)
    if wanted and (
        any(map(default_slots.has_empty, objects)) or any(map(materials.reflects, theirs))
    ):
        return True
    others = set(materials.attached()) - set(theirs)
    return any(materials.reflection_of(material) is not None for material in others)


def notes(
    scene: bpy.types.Scene, objects: list[bpy.types.Object], largest_image: int = 0
) -> list[str]:
    """What the artist should know beforehand, one sentence each; ``largest_image`` is the side of
    the image that may be made."""
    found = [
        f"Material {name!r} keeps its own look: it has no Principled or Diffuse BSDF outside of a "
        "group that could show the bake"
        for name in materials.without_bake(materials_of(objects, carrier.depsgraph_of(scene)))
    ]
    found += [
        f"Cycles will not subdivide {obj.name!r} adaptively while it is baked"
        for obj in objects
        if carrier.ends_adaptive_subdivision(obj)
    ]
    limit = LIMITS.get(bpy.context.preferences.system.gl_texture_limit, largest_image)
    if limit < largest_image:
        found.append(
            f"The preferences limit textures to {limit}, so the viewport shows the bake coarsely: "
            "set Viewport > Textures > Limit Size to Off"
        )
    return found


def materials_of(
    objects: Iterable[bpy.types.Object], depsgraph: bpy.types.Depsgraph
) -> list[bpy.types.Material]:
    """The materials of all ``objects``, each once."""
    found = (material for obj in objects for material in materials.of(obj, depsgraph))
    return list(dict.fromkeys(found))


def _check_texture(material: bpy.types.Material) -> None:
    """Refuse what EEVEE cannot show beside an atlas and its UV map."""
    reads = material_attributes.of(material) | {("named", uv_maps.NAME)}
    if len(reads) > layouts.MAX_ATTRIBUTES:
        raise BakeError(
            f"Material {material.name!r} reads {len(reads) - 1} attributes, and EEVEE at most "
            f"{layouts.MAX_ATTRIBUTES}, one of them the bake's UV map: let it read fewer"
        )


def _check_samplers(material: bpy.types.Material, ours: int) -> None:
    """Refuse where ``ours`` textures don't fit beside those of ``material``."""
    textures = len(material_samplers.of(material))
    if ours and textures + ours > material_samplers.MOST:
        words = "one of them the bake's" if ours == 1 else f"{ours} of them the bake's"
        raise BakeError(
            f"Material {material.name!r} reads {textures} textures, and EEVEE at most "
            f"{material_samplers.MOST}, {words}: let it read fewer"
        )


def _check_shared(
    objects: list[bpy.types.Object],
    possible: tuple[Layout, Layout],
    carriers: Sequence[str],
    depsgraph: bpy.types.Depsgraph,
) -> None:
    """One material shows one layout and one atlas."""
    wanted = {
        look: one
        for obj, one in zip(objects, carriers, strict=True)
        for look in sharing.looks(obj, depsgraph)
    }
    for other in bpy.data.objects:
        its_stamp = stamp.read(other)
        if other in objects or its_stamp is None:
            continue
        alike = its_stamp.packing.between(*possible) and not its_stamp.in_atlas
        shared = [look for look in sharing.looks(other, depsgraph) if look in wanted]
        clash = next((look for look in shared if not alike or wanted[look] != "vertex"), None)
        if clash is not None:
            where = "in a texture" if its_stamp.in_atlas else f"with {its_stamp.packing}"
            raise BakeError(
                f"{other.name!r} was baked {where} and shares {sharing.words(clash)}: "
                "bake both together, or with the same settings"
            )
