"""The bake of an object whose mesh cannot hold it, because of its modifiers or other users.

The values lie on a carrier: an object outside every scene with a copy of the evaluated mesh.  The
object's last modifier reads them from there.
"""

from collections.abc import Iterator
from contextlib import contextmanager

import bpy
import numpy as np
import numpy.typing as npt

from . import attributes, carrier_nodes

MODIFIER = "PRT Bake"
TAG = "prt_carrier"


def needs_modifier(obj: bpy.types.Object, depsgraph: bpy.types.Depsgraph) -> bool:
    """Whether the mesh of ``obj`` is not what is shown, or is shown by others too."""
    mesh = obj.data
    if mesh.users - mesh.use_fake_user > 1 or any(map(_makes_geometry, obj.modifiers)):
        return True
    with evaluated_mesh(obj, depsgraph) as shown:
        return not np.array_equal(_topology(mesh), _topology(shown))


def ends_adaptive_subdivision(obj: bpy.types.Object) -> bool:
    """Whether Cycles dices ``obj`` now, and will not behind our modifier: it asks the last one."""
    others = [m for m in obj.modifiers if not carrier_nodes.is_ours(m)]
    if not others or others[-1].type != "SUBSURF":
        return False
    if bpy.app.version >= (5, 0):
        return others[-1].use_adaptive_subdivision
    return "cycles" in obj and bool(obj.cycles.use_adaptive_subdivision)


def make(
    obj: bpy.types.Object, depsgraph: bpy.types.Depsgraph, stored: attributes.Stored
) -> bpy.types.Object:
    """A carrier of ``stored`` for ``obj``, which stays as it is until ``connect``."""
    mesh = bpy.data.meshes.new_from_object(obj.evaluated_get(depsgraph), depsgraph=depsgraph)
    mesh.name = f"{obj.name} PRT"
    mesh.materials.clear()
    for name in [a.name for a in mesh.attributes if not (a.is_required or a.is_internal)]:
        mesh.attributes.remove(mesh.attributes[name])
    attributes.put(mesh, stored)
    carrier = bpy.data.objects.new(mesh.name, mesh)
    carrier[TAG] = True
    return carrier


def connect(obj: bpy.types.Object, carrier: bpy.types.Object) -> None:
    """Let ``obj`` show what ``carrier`` holds."""
    active = obj.modifiers.active
    modifier = carrier_nodes.modifier_of(obj) or obj.modifiers.new(MODIFIER, "NODES")
    obj.modifiers.move(list(obj.modifiers).index(modifier), len(obj.modifiers) - 1)
    modifier.show_expanded = False
    names = attributes.names(carrier.data)
    domain = carrier.data.attributes[names[0]].domain
    modifier.node_group = carrier_nodes.group(domain, names)
    carrier_nodes.set_carrier(modifier, carrier)
    if active is not None:
        obj.modifiers.active = active
    obj.update_tag()


def disconnect(obj: bpy.types.Object) -> None:
    """Take the modifier away; the carrier stays until ``free_unused``."""
    modifier = carrier_nodes.modifier_of(obj)
    if modifier is not None:
        active = obj.modifiers.active
        kept = active if active != modifier else None
        carrier_nodes.set_carrier(modifier, None)  # else 5.2 still counts it as used
        obj.modifiers.remove(modifier)
        if kept is not None:
            obj.modifiers.active = kept
        obj.update_tag()


def of(obj: bpy.types.Object) -> bpy.types.Object | None:
    """The carrier that ``obj`` shows; None where it has none."""
    return carrier_nodes.carrier_of(obj)


def free_unused() -> None:
    """Delete carriers and node groups that no modifier reads."""
    shown = {carrier_nodes.carrier_of(obj) for obj in bpy.data.objects}
    for carrier in [obj for obj in bpy.data.objects if TAG in obj and obj not in shown]:
        bpy.data.meshes.remove(carrier.data)
    carrier_nodes.free_unused()


def depsgraph_of(scene: bpy.types.Scene) -> bpy.types.Depsgraph:
    """``scene`` evaluated as the viewport shows it."""
    context = bpy.context
    layer = context.view_layer if context.scene == scene else scene.view_layers[0]
    layer.update()
    return layer.depsgraph


@contextmanager
def evaluated_mesh(
    obj: bpy.types.Object, depsgraph: bpy.types.Depsgraph
) -> Iterator[bpy.types.Mesh]:
    """The mesh that is shown, after all modifiers."""
    evaluated = obj.evaluated_get(depsgraph)
    yield evaluated.to_mesh()
    evaluated.to_mesh_clear()


def _makes_geometry(modifier: bpy.types.Modifier) -> bool:
    """Node trees may replace a mesh by one of equal counts, without its attributes."""
    ours = carrier_nodes.is_ours(modifier)
    return modifier.type == "NODES" and modifier.show_viewport and not ours


def _topology(mesh: bpy.types.Mesh) -> npt.NDArray[np.int32]:
    """The vertices of all corners, and how many vertices there are."""
    corners = np.empty(len(mesh.loops) + 1, np.int32)
    if len(mesh.loops):
        mesh.attributes[".corner_vert"].data.foreach_get("value", corners[1:])
    corners[0] = len(mesh.vertices)
    return corners
