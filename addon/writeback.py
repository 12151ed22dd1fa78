"""A finished bake into the scene: all of it or nothing."""

from collections.abc import Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from typing import Any

import bpy

from . import (
    atlas_images,
    attributes,
    carrier,
    default_slots,
    default_surface,
    materials,
    nodes,
    reflections,
    stamp,
    write_checks,
)
from .prt.errors import BakeError
from .prt.layout import Layout
from .prt.results import ReceiverResult
from .stamp import Stamp

Baked = tuple[bpy.types.Object, ReceiverResult, Stamp]
Images = Sequence[bpy.types.Image]
set_light = nodes.set_light
check, notes, reflects = write_checks.check, write_checks.notes, write_checks.reflects


def write(
    scene: bpy.types.Scene,
    baked: list[Baked],
    layout: Layout,
    images: Images = (),
    reflected: bpy.types.Image | None = None,
) -> None:
    """Give every object its values, stamp and materials; on any error all stays as it was.

    ``images`` are the atlases, in the order of their numbers; ``reflected`` is what shiny materials
    reflect from now on, those of other bakes too, or None.
    """
    objects = [obj for obj, _, _ in baked]
    check(scene, objects, layout, carriers=[mark.carrier for _, _, mark in baked])
    depsgraph = carrier.depsgraph_of(scene)
    with ExitStack() as undo:
        undo.callback(_free_unused)
        prepared = [_prepare(depsgraph, layout, one, images) for one in baked]
        for one in prepared:
            _write_object(undo, one)
        shown = {
            material: one.image
            for one in prepared
            for material in write_checks.materials_of([one.obj], depsgraph)
        }
        if reflected is not None:
            _reflect(undo, reflected)
        for material, image in shown.items():
            _attach(undo, material, (layout, image, reflected))
        undo.pop_all()
    if reflected is not None:
        reflections.replace(reflected)
    _free_unused()


@dataclass(frozen=True)
class _Prepared:
    """What ``obj`` gets: ``holder`` is its new carrier, or None where its own mesh takes what is
    ``stored``; and the ``image`` that it shows, or None."""

    obj: bpy.types.Object
    holder: bpy.types.Object | None
    stored: attributes.Stored
    stamp: Stamp
    image: bpy.types.Image | None


def _prepare(
    depsgraph: bpy.types.Depsgraph, layout: Layout, baked: Baked, images: Images
) -> _Prepared:
    """Everything that can fail, before the object is touched."""
    obj, result, its_stamp = baked
    domain, placed = its_stamp.domain, result.in_atlas
    with carrier.evaluated_mesh(obj, depsgraph) as mesh:
        expected = len(mesh.vertices if domain == "POINT" else mesh.loops)
        if placed is not None:
            count, stored = len(placed.uvs), attributes.with_uvs(placed.uvs, mesh)
        else:
            stored = attributes.of_result(result, layout, domain)
            count = len(result.element_points)
    if count != expected:
        raise BakeError(f"The mesh of {obj.name!r} was edited while it baked: bake it again")
    image = images[placed.atlas] if placed is not None else None
    if its_stamp.own_uvs:
        return _Prepared(obj, None, {}, its_stamp, image)
    if its_stamp.by_modifier:
        holder = carrier.make(obj, depsgraph, stored)
        return _Prepared(obj, holder, {}, its_stamp, image)
    return _Prepared(obj, None, stored, its_stamp, image)


def _write_object(undo: ExitStack, one: _Prepared) -> None:
    obj, mesh = one.obj, one.obj.data
    undo.callback(_restore, obj, attributes.take(mesh), carrier.of(obj), _marks(obj))
    if one.holder is None:
        carrier.disconnect(obj)
        attributes.put(mesh, one.stored)
    else:
        carrier.connect(obj, one.holder)
        if not _held_by_mesh(mesh, obj):
            attributes.remove(mesh)
    undo.callback(default_slots.restore, obj, default_slots.filled(obj))
    default_slots.fill(obj)
    stamp.write(obj, one.stamp)
    stamp.set_share(obj, 1.0)
    stamp.set_image(obj, one.image)


def _restore(
    obj: bpy.types.Object,
    stored: attributes.Stored,
    holder: bpy.types.Object | None,
    marks: dict[str, Any],
) -> None:
    """Back to what ``obj`` was before."""
    attributes.put(obj.data, stored)
    if holder is None:
        carrier.disconnect(obj)
    else:
        carrier.connect(obj, holder)
    stamp.remove(obj)
    for key, value in marks.items():
        obj[key] = value


def _marks(obj: bpy.types.Object) -> dict[str, Any]:
    return {key: obj[key] for key in stamp.MARKS if key in obj}


def reflect(reflected: bpy.types.Image | None) -> None:
    """Let every shiny material reflect another image; None leaves all as it is."""
    if reflected is not None:
        nodes.reflect(reflected)
        reflections.replace(reflected)


def _reflect(undo: ExitStack, reflected: bpy.types.Image) -> None:
    before = reflections.current()
    if before not in (None, reflected):
        undo.callback(nodes.reflect, before)
    nodes.reflect(reflected)


def _attach(
    undo: ExitStack,
    material: bpy.types.Material,
    look: tuple[Layout, bpy.types.Image | None, bpy.types.Image | None],
) -> None:
    """Show ``look``: a layout, its atlas, and what is reflected."""
    before = materials.layout_of(material)
    if before is None:
        undo.callback(materials.detach, material)
    else:
        now = materials.image_of(material), materials.reflection_of(material)
        undo.callback(materials.attach, material, before, *now)
    materials.attach(material, *look)


def _free_unused() -> None:
    carrier.free_unused()
    nodes.free_unused()
    atlas_images.free_unused()
    reflections.free_unused()
    default_surface.free_unused()


def _held_by_mesh(mesh: bpy.types.Mesh, but: bpy.types.Object) -> bool:
    """Whether another object shows the values that lie on ``mesh``."""
    stamps = (stamp.read(obj) for obj in bpy.data.objects if obj.data == mesh and obj != but)
    return any(found is not None and not found.by_modifier for found in stamps)
