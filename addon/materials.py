"""Hanging the bake on materials, following the artist's edits, and taking it off again."""

import hashlib
import json
from collections.abc import Iterable
from dataclasses import asdict

import bpy

from . import default_surface, material_plan, reflections, shading_tree
from .material_plan import SHADING, SURFACE, TAG, Plan
from .prt.layout import Layout

STATE = "prt_bake"  # JSON: what the tree was made of, and what detach has to restore
ATLAS = "prt_image"  # the image that is shown, where the bake is in one


def of(obj: bpy.types.Object, depsgraph: bpy.types.Depsgraph) -> list[bpy.types.Material]:
    """Every material that ``obj`` may show: of its slots, and those that its modifiers set."""
    found = [slot.material for slot in obj.material_slots]
    data = obj.evaluated_get(depsgraph).data
    found += [material and material.original for material in getattr(data, "materials", ())]
    return [material for material in dict.fromkeys(found) if material is not None]


def attach(
    material: bpy.types.Material,
    layout: Layout,
    image: bpy.types.Image | None = None,
    reflected: bpy.types.Image | None = None,
) -> None:
    """Let ``material`` show bakes of ``layout`` in EEVEE, on vertices or in ``image``, and reflect
    ``reflected`` where it is shiny; the artist's nodes stay as they are."""
    kept = shading_tree.switches(material.node_tree) if STATE in material else {}
    detach(material)
    state = {
        "layout": asdict(layout),
        "active": "",
        "had_nodes": default_surface.has_nodes(material),
        "reflects": reflected is not None,
    }
    if not state["had_nodes"]:
        default_surface.give(material)
    tree = material.node_tree
    plan = material_plan.read(tree, reflects=reflected is not None)
    theirs = material_plan.artist_output(tree)
    ours = shading_tree.build(tree, plan, layout, image, reflected)
    shading_tree.set_switches(tree, kept)
    if theirs is not None and theirs.target == "EEVEE":
        state["active"] = _active_output(tree)
        ours.is_active_output = True
    state["structure"] = _structure(plan)
    material[STATE] = json.dumps(state)
    if image is not None:
        material[ATLAS] = image


def detach(material: bpy.types.Material) -> None:
    """Take our nodes off again and leave ``material`` as the artist made it."""
    state = _state(material)
    if not state:
        return
    tree = material.node_tree
    shading_tree.clear(tree, SHADING)
    shading_tree.clear(tree, SURFACE)
    active = tree.nodes.get(state["active"])
    if active is not None:
        active.is_active_output = True
    if not state["had_nodes"]:
        default_surface.take(material)
    del material[STATE]
    if ATLAS in material:
        del material[ATLAS]


def layout_of(material: bpy.types.Material) -> Layout | None:
    """The layout that ``material`` shows; None where it shows no bake."""
    state = _state(material)
    return Layout.of(state["layout"]) if state else None


def image_of(material: bpy.types.Material) -> bpy.types.Image | None:
    """The image that ``material`` shows; None where it shows vertices, or no bake."""
    return material.get(ATLAS)


def reflection_of(material: bpy.types.Material) -> bpy.types.Image | None:
    """The light that ``material`` reflects where it is shiny; None where it shows no bake, or one
    without reflections."""
    return reflections.current() if _state(material).get("reflects") else None


def reflects(material: bpy.types.Material) -> bool:
    """Whether ``material`` is shiny, so that a bake could have reflections."""
    if not default_surface.has_nodes(material):
        return True  # EEVEE shows a Principled BSDF
    return material_plan.reflects(
        material_plan.read(
            material.node_tree, _state(material).get("active", ""), reflects=True
        ).surface
    )


def attached() -> list[bpy.types.Material]:
    """The materials of the file that show bakes."""
    return [m for m in bpy.data.materials if STATE in m and m.library is None]


def refresh(material: bpy.types.Material, depsgraph: bpy.types.Depsgraph) -> bool:
    """Follow edits and animation of ``material``; True when something had to change."""
    state = _state(material)
    tree = material.node_tree
    if not state or tree is None:
        return False
    evaluated = material.evaluated_get(depsgraph)  # in a render only this one is animated
    reflected = reflection_of(material)
    plan = material_plan.read(evaluated.node_tree, state["active"], reflects=reflected is not None)
    whole = shading_tree.is_whole(tree, plan)
    if whole and state["structure"] == _structure(plan):
        return shading_tree.sync(tree, plan)
    attach(material, Layout.of(state["layout"]), image_of(material), reflected)
    return True


def sync_all(depsgraph: bpy.types.Depsgraph) -> bool:
    """``refresh`` for every material that shows bakes."""
    changed = [refresh(material, depsgraph) for material in attached()]
    return any(changed)


def without_bake(materials: Iterable[bpy.types.Material]) -> list[str]:
    """The names of those in which no shader can show a bake: they keep the artist's look."""
    names = []
    for material in materials:
        if default_surface.has_nodes(material):
            state = _state(material)
            plan = material_plan.read(material.node_tree, state.get("active", ""))
            if not material_plan.shows_bake(plan.surface):
                names.append(material.name)
    return names


def _state(material: bpy.types.Material) -> dict:
    return json.loads(material.get(STATE, "{}"))


def _structure(plan: Plan) -> str:
    """A name for the plan without the values in it."""
    bare = material_plan.without_values(plan.surface)
    return hashlib.sha256(repr((plan.own, bare, plan.others)).encode()).hexdigest()


def _active_output(tree: bpy.types.NodeTree) -> str:
    outputs = (n for n in tree.nodes if n.type == "OUTPUT_MATERIAL" and n.get(TAG) != SHADING)
    return next((node.name for node in outputs if node.is_active_output), "")
