"""The node group *PRT Shading*: baked transfer times the light that it holds.

One group for each layout in use, and one light for all of them.  Inputs: Base Color.  Outputs:
Shader, an emission, and Exit Radiance, its colour (W sr⁻¹ m⁻², base colour included, never
negative).
"""

import json
from dataclasses import asdict

import bpy
import numpy as np
import numpy.typing as npt

from .prt.layout import Layout

NAME = "PRT Shading"
TAG = "prt_layout"
Sockets = list[bpy.types.NodeSocket]


def group(layout: Layout) -> bpy.types.NodeTree:
    """The group that shades bakes of ``layout``, made where there is none yet."""
    found = next((tree for tree in groups() if layout_of(tree) == layout), None)
    return found or _build(layout)


def groups() -> list[bpy.types.NodeTree]:
    """Every PRT Shading group of the file."""
    return [tree for tree in bpy.data.node_groups if TAG in tree]


def layout_of(tree: bpy.types.NodeTree) -> Layout:
    """The layout of the attributes that the group reads."""
    return Layout(**json.loads(tree[TAG]))


def set_light(radiance_sh: npt.NDArray[np.float64]) -> bool:
    """Light every group with coefficients (25, 3), W sr⁻¹ m⁻²; True when something changed."""
    radiance = np.asarray(radiance_sh, np.float32)
    changed = [_light(tree, radiance) for tree in groups()]
    return any(changed)


def free_unused() -> None:
    """Delete the groups that no material has; the first that is left has the plain name."""
    for tree in [tree for tree in groups() if not tree.users]:
        bpy.data.node_groups.remove(tree)
    if groups() and NAME not in bpy.data.node_groups:
        groups()[0].name = NAME


def _light(tree: bpy.types.NodeTree, radiance: npt.NDArray[np.float32]) -> bool:
    changed = False
    for i in range(layout_of(tree).order ** 2):
        socket = tree.nodes[f"L{i}"].inputs[1]
        if not np.array_equal(socket.default_value, radiance[i]):
            socket.default_value = radiance[i]
            changed = True
    return changed


def _build(layout: Layout) -> bpy.types.NodeTree:
    several = f"order {layout.order}" + ", RGB" * (layout.channels == 3)
    name = f"{NAME} ({several})" if NAME in bpy.data.node_groups else NAME
    tree = bpy.data.node_groups.new(name, "ShaderNodeTree")
    tree[TAG] = json.dumps(asdict(layout))
    _interface(tree)
    total = _weighted_sum(tree, _transfer(tree, layout))
    _shade(tree, total, layout.order**2)
    return tree


def _interface(tree: bpy.types.NodeTree) -> None:
    face = tree.interface
    colour = face.new_socket("Base Color", in_out="INPUT", socket_type="NodeSocketColor")
    colour.default_value = (1, 1, 1, 1)
    face.new_socket("Shader", in_out="OUTPUT", socket_type="NodeSocketShader")
    face.new_socket("Exit Radiance", in_out="OUTPUT", socket_type="NodeSocketColor")


def _transfer(tree: bpy.types.NodeTree, layout: Layout) -> Sockets:
    """The transfer of each coefficient, a number or a colour."""
    floats: Sockets = []
    for k, name in enumerate(layout.attributes):
        floats += _four_floats(tree, name, k, min(layout.transfer_slots - 4 * k, 4))
    if layout.channels == 1:
        return floats
    return [_combined(tree, floats[3 * i : 3 * i + 3], i) for i in range(layout.order**2)]


def _four_floats(tree: bpy.types.NodeTree, name: str, row: int, used: int) -> Sockets:
    """The first ``used`` floats of an attribute.  An alpha that is not used stays unread: where
    the attribute is missing it is 1."""
    if used <= 0:
        return []
    attribute = _node(tree, "ShaderNodeAttribute", -700, -220 * row)
    attribute.attribute_type, attribute.attribute_name = "GEOMETRY", name
    separate = _node(tree, "ShaderNodeSeparateXYZ", -500, -220 * row)
    tree.links.new(attribute.outputs["Vector"], separate.inputs[0])
    return [*separate.outputs, attribute.outputs["Alpha"]][:used]


def _combined(tree: bpy.types.NodeTree, floats: Sockets, row: int) -> bpy.types.NodeSocket:
    combine = _node(tree, "ShaderNodeCombineXYZ", -300, -150 * row)
    for socket, place in zip(floats, combine.inputs, strict=True):
        tree.links.new(socket, place)
    return combine.outputs[0]


def _weighted_sum(tree: bpy.types.NodeTree, transfer: Sockets) -> bpy.types.NodeSocket:
    """The sum of transfer times light; node ``L i`` holds the light's coefficient i."""
    total: bpy.types.NodeSocket | None = None
    for i, factor in enumerate(transfer):
        term = _node(tree, "ShaderNodeVectorMath", -100 + 180 * i, -60 * i)
        term.name = term.label = f"L{i}"
        term.operation = "MULTIPLY_ADD"
        term.inputs[1].default_value = term.inputs[2].default_value = (0, 0, 0)
        tree.links.new(factor, term.inputs[0])
        if total is not None:
            tree.links.new(total, term.inputs[2])
        total = term.outputs[0]
    return total


def _shade(tree: bpy.types.NodeTree, total: bpy.types.NodeSocket, column: int) -> None:
    """Clamped at 0, times the base colour, as an emission."""
    x = 180 * column
    clamp = _node(tree, "ShaderNodeVectorMath", x, 0)
    clamp.operation = "MAXIMUM"
    albedo = _node(tree, "ShaderNodeVectorMath", x + 180, 0)
    albedo.operation = "MULTIPLY"
    emission = _node(tree, "ShaderNodeEmission", x + 360, 0)
    inside = _node(tree, "NodeGroupInput", x, 200)
    outside = _node(tree, "NodeGroupOutput", x + 540, 0)
    tree.links.new(total, clamp.inputs[0])
    tree.links.new(clamp.outputs[0], albedo.inputs[0])
    tree.links.new(inside.outputs["Base Color"], albedo.inputs[1])
    tree.links.new(albedo.outputs[0], emission.inputs["Color"])
    tree.links.new(emission.outputs[0], outside.inputs["Shader"])
    tree.links.new(albedo.outputs[0], outside.inputs["Exit Radiance"])


def _node(tree: bpy.types.NodeTree, kind: str, x: float, y: float) -> bpy.types.Node:
    node = tree.nodes.new(kind)
    node.location = (x, y)
    return node
