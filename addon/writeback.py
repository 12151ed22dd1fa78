"""A finished bake into the scene: all of it or nothing."""

from contextlib import ExitStack
from dataclasses import dataclass
from typing import Any

import bpy

from . import (
    attributes,
    carrier,
    default_slots,
    default_surface,
    material_attributes,
    materials,
    nodes,
    stamp,
)
from .prt import layout as layouts
from .prt.errors import BakeError
from .prt.layout import Layout
from .prt.results import ReceiverResult
from .stamp import Stamp

Baked = tuple[bpy.types.Object, ReceiverResult, Stamp]
set_light = nodes.set_light


def check(
    scene: bpy.types.Scene,
    objects: list[bpy.types.Object],
    layout: Layout,
    least: Layout | None = None,
) -> None:
    """Refuse, before anything is baked, what could not be written or shown afterwards.

    ``layout`` is the most that will be stored, ``least`` the least, where that is not yet known.
    """
    layouts.check(layout)
    depsgraph = carrier.depsgraph_of(scene)
    for obj in objects:
        for material in materials.of(obj, depsgraph):
            if material.library is not None:
                raise BakeError(
                    f"Material {material.name!r} of {obj.name!r} is linked from another file: "
                    "make it local, or give the object a material of this file"
                )
            layouts.check(layout, len(material_attributes.of(material)), material.name)
    _check_shared(objects, least or layout, layout, depsgraph)


def notes(scene: bpy.types.Scene, objects: list[bpy.types.Object]) -> list[str]:
    """What the artist should know beforehand, one sentence each."""
    found = _materials_of(objects, carrier.depsgraph_of(scene))
    return [
        f"Material {name!r} keeps its own look: it has no Principled or Diffuse BSDF outside of a "
        "group that could show the bake"
        for name in materials.without_bake(found)
    ] + [
        f"Cycles will not subdivide {obj.name!r} adaptively while it is baked"
        for obj in objects
        if carrier.ends_adaptive_subdivision(obj)
    ]


def write(scene: bpy.types.Scene, baked: list[Baked], layout: Layout) -> None:
    """Give every object its values, stamp and materials; on any error all stays as it was."""
    check(scene, [obj for obj, _, _ in baked], layout)
    depsgraph = carrier.depsgraph_of(scene)
    with ExitStack() as undo:
        undo.callback(_free_unused)
        prepared = [_prepare(depsgraph, layout, *one) for one in baked]
        for one in prepared:
            _write_object(undo, one)
        for material in _materials_of([one.obj for one in prepared], depsgraph):
            _attach(undo, material, layout)
        undo.pop_all()
    _free_unused()


@dataclass(frozen=True)
class _Prepared:
    """What ``obj`` gets: ``holder`` is its new carrier, or None where its own mesh takes the
    values."""

    obj: bpy.types.Object
    holder: bpy.types.Object | None
    stored: attributes.Stored
    stamp: Stamp


def _prepare(
    depsgraph: bpy.types.Depsgraph,
    layout: Layout,
    obj: bpy.types.Object,
    result: ReceiverResult,
    its_stamp: Stamp,
) -> _Prepared:
    """Everything that can fail, before the object is touched."""
    domain = its_stamp.domain
    values = layouts.pack(layout, layouts.at_elements(result))
    with carrier.evaluated_mesh(obj, depsgraph) as mesh:
        expected = len(mesh.vertices if domain == "POINT" else mesh.loops)
    if len(values) != expected:
        raise BakeError(f"The mesh of {obj.name!r} was edited while it baked: bake it again")
    if its_stamp.by_modifier:
        holder = carrier.make(obj, depsgraph, layout, domain, values)
        return _Prepared(obj, holder, {}, its_stamp)
    return _Prepared(obj, None, attributes.split(layout, domain, values), its_stamp)


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


def _attach(undo: ExitStack, material: bpy.types.Material, layout: Layout) -> None:
    before = materials.layout_of(material)
    if before is None:
        undo.callback(materials.detach, material)
    else:
        undo.callback(materials.attach, material, before)
    materials.attach(material, layout)


def _free_unused() -> None:
    carrier.free_unused()
    nodes.free_unused()
    default_surface.free_unused()


def _held_by_mesh(mesh: bpy.types.Mesh, but: bpy.types.Object) -> bool:
    """Whether another object shows the values that lie on ``mesh``."""
    stamps = (stamp.read(obj) for obj in bpy.data.objects if obj.data == mesh and obj != but)
    return any(found is not None and not found.by_modifier for found in stamps)


def _check_shared(
    objects: list[bpy.types.Object], least: Layout, most: Layout, depsgraph: bpy.types.Depsgraph
) -> None:
    """One material shows one layout."""
    wanted = set(_materials_of(objects, depsgraph))
    for other in bpy.data.objects:
        its_stamp = stamp.read(other)
        if other in objects or its_stamp is None or its_stamp.packing.between(least, most):
            continue
        shared = next((m for m in materials.of(other, depsgraph) if m in wanted), None)
        if shared is not None:
            raise BakeError(
                f"{other.name!r} was baked with {its_stamp.packing} and shares material "
                f"{shared.name!r}: bake both together, or with the same settings"
            )


def _materials_of(
    objects: list[bpy.types.Object], depsgraph: bpy.types.Depsgraph
) -> list[bpy.types.Material]:
    found = (material for obj in objects for material in materials.of(obj, depsgraph))
    return list(dict.fromkeys(found))
