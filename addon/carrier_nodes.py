"""The geometry nodes that store a carrier's values on the object that wears the modifier."""

import json
from collections.abc import Sequence
from dataclasses import dataclass

import bpy

from . import uv_maps

TAG = "prt_carrier_group"
PULL = 0.01  # of the way from a corner to the middle of its face
ACROSS = 0.5  # of half way off the straight line: on another chart
COLOUR = ("FLOAT_COLOR", "FLOAT_COLOR", "RGBA")  # as it is stored, read, and switched between
UVS = ("FLOAT2", "FLOAT_VECTOR", "VECTOR")
COUNTS = {"POINT": "Point Count", "CORNER": "Face Corner Count"}


def group(domain: str, names: Sequence[str]) -> bpy.types.NodeTree:
    """The group that stores the attributes ``names`` on ``domain``; all objects alike share it."""
    key = json.dumps([domain, names])
    for tree in bpy.data.node_groups:
        if tree.get(TAG) == key:
            return tree
    return _build(domain, names, key)


def is_ours(modifier: bpy.types.Modifier) -> bool:
    """Whether ``modifier`` shows a carrier."""
    tree = modifier.node_group if modifier.type == "NODES" else None
    return tree is not None and TAG in tree


def set_carrier(modifier: bpy.types.Modifier, carrier: bpy.types.Object | None) -> None:
    """Let ``modifier`` read ``carrier``."""
    identifier = _identifier(modifier.node_group)
    if bpy.app.version >= (5, 2):
        getattr(modifier.properties.inputs, identifier).value = carrier
    else:
        modifier[identifier] = carrier


def modifier_of(obj: bpy.types.Object) -> bpy.types.Modifier | None:
    """The modifier of ``obj`` that shows a carrier."""
    return next(filter(is_ours, obj.modifiers), None)


def carrier_of(obj: bpy.types.Object) -> bpy.types.Object | None:
    """The carrier that ``obj`` shows; None where it has none."""
    modifier = modifier_of(obj)
    if modifier is None:
        return None
    identifier = _identifier(modifier.node_group)
    if bpy.app.version >= (5, 2):
        return getattr(modifier.properties.inputs, identifier).value
    return modifier.get(identifier)


def free_unused() -> None:
    """Delete the groups that no modifier has."""
    for tree in [tree for tree in bpy.data.node_groups if TAG in tree and not tree.users]:
        bpy.data.node_groups.remove(tree)


def _identifier(tree: bpy.types.NodeTree) -> str:
    return next(i.identifier for i in tree.interface.items_tree if i.name == "Carrier")


@dataclass(frozen=True)
class _Source:
    """Where the values come from: the carrier's geometry, and a number above 0 where it has not as
    many elements of ``domain`` as what is shown."""

    domain: str
    geometry: bpy.types.NodeSocket
    differ: bpy.types.NodeSocket


def _build(domain: str, names: Sequence[str], key: str) -> bpy.types.NodeTree:
    tree = bpy.data.node_groups.new("PRT Bake", "GeometryNodeTree")
    tree[TAG] = key
    face = tree.interface
    face.new_socket("Geometry", in_out="INPUT", socket_type="NodeSocketGeometry")
    face.new_socket("Carrier", in_out="INPUT", socket_type="NodeSocketObject")
    face.new_socket("Geometry", in_out="OUTPUT", socket_type="NodeSocketGeometry")
    inside = _node(tree, "NodeGroupInput", -900, 0)
    info = _node(tree, "GeometryNodeObjectInfo", -700, -200)
    tree.links.new(inside.outputs["Carrier"], info.inputs["Object"])
    geometry, carrier = inside.outputs["Geometry"], info.outputs["Geometry"]
    differ = _counts_differ(tree, geometry, carrier, COUNTS[domain])
    source = _Source(domain, carrier, differ)
    for column, name in enumerate(names):
        geometry = _stored(tree, geometry, source, name, 220 * column)
    outside = _node(tree, "NodeGroupOutput", 300 + 220 * len(names), 0)
    tree.links.new(geometry, outside.inputs["Geometry"])
    return tree


def _counts_differ(
    tree: bpy.types.NodeTree,
    shown: bpy.types.NodeSocket,
    carrier: bpy.types.NodeSocket,
    count: str,
) -> bpy.types.NodeSocket:
    """Above 0 where the two geometries have not the same number of elements."""
    subtract = _node(tree, "ShaderNodeMath", -300, 200, operation="SUBTRACT")
    absolute = _node(tree, "ShaderNodeMath", -120, 200, operation="ABSOLUTE")
    for place, geometry in enumerate((shown, carrier)):
        size = _node(tree, "GeometryNodeAttributeDomainSize", -500, 300 - 200 * place)
        tree.links.new(geometry, size.inputs["Geometry"])
        tree.links.new(size.outputs[count], subtract.inputs[place])
    tree.links.new(subtract.outputs[0], absolute.inputs[0])
    return absolute.outputs[0]


def _inside_face(tree: bpy.types.NodeTree, share: float) -> bpy.types.NodeSocket:
    """A corner's place pulled into its face by ``share`` of the way to its middle."""
    position = _node(tree, "GeometryNodeInputPosition", -900, -800)
    centre = _node(tree, "GeometryNodeFieldOnDomain", -700, -900, data_type="FLOAT_VECTOR")
    centre.domain = "FACE"
    towards = _node(tree, "ShaderNodeVectorMath", -500, -900, operation="SUBTRACT")
    pulled = _node(tree, "ShaderNodeVectorMath", -300, -800, operation="MULTIPLY_ADD")
    pulled.inputs[1].default_value = (share,) * 3
    tree.links.new(position.outputs[0], centre.inputs["Value"])
    tree.links.new(centre.outputs[0], towards.inputs[0])
    tree.links.new(position.outputs[0], towards.inputs[1])
    tree.links.new(towards.outputs[0], pulled.inputs[0])
    tree.links.new(position.outputs[0], pulled.inputs[2])
    return pulled.outputs[0]


def _stored(
    tree: bpy.types.NodeTree, geometry: bpy.types.NodeSocket, source: _Source, name: str, x: float
) -> bpy.types.NodeSocket:
    """``geometry`` with the source's attribute ``name`` on it."""
    store = _node(tree, "GeometryNodeStoreNamedAttribute", x, 200)
    store.data_type, store.domain = _types(name)[0], source.domain
    store.inputs["Name"].default_value = name
    tree.links.new(geometry, store.inputs["Geometry"])
    tree.links.new(_sampled(tree, source, name, x), store.inputs["Value"])
    return store.outputs["Geometry"]


def _types(name: str) -> tuple[str, str, str]:
    return UVS if name in {uv_maps.EMPTY, uv_maps.NAME} else COLOUR


def _sampled(
    tree: bpy.types.NodeTree, source: _Source, name: str, x: float
) -> bpy.types.NodeSocket:
    """The source's attribute ``name``: by index, or from its nearest surface."""
    _, kind, switched = _types(name)
    named = _node(tree, "GeometryNodeInputNamedAttribute", x, -1100, data_type=kind)
    named.inputs["Name"].default_value = name
    by_index = _node(tree, "GeometryNodeSampleIndex", x, -550, data_type=kind)
    by_index.domain = source.domain
    index = _node(tree, "GeometryNodeInputIndex", x, -450)
    switch = _node(tree, "GeometryNodeSwitch", x, -200, input_type=switched)
    value = named.outputs["Attribute"]
    tree.links.new(index.outputs["Index"], by_index.inputs["Index"])
    tree.links.new(source.geometry, by_index.inputs["Geometry"])
    tree.links.new(value, by_index.inputs["Value"])
    tree.links.new(source.differ, switch.inputs["Switch"])
    tree.links.new(by_index.outputs["Value"], switch.inputs["False"])
    nearest = _uvs_nearby if name == uv_maps.NAME else _nearest
    tree.links.new(nearest(tree, source, value, x), switch.inputs["True"])
    return switch.outputs["Output"]


def _nearest(
    tree: bpy.types.NodeTree,
    source: _Source,
    value: bpy.types.NodeSocket,
    x: float,
    share: float = PULL,
) -> bpy.types.NodeSocket:
    """``value`` on the nearest surface of the source.  From a corner it is looked for a ``share``
    of the way into its face, so that it is not found across a sharp edge."""
    kind = UVS[1] if value.type == "VECTOR" else COLOUR[1]
    nearest = _node(tree, "GeometryNodeSampleNearestSurface", x, -800, data_type=kind)
    tree.links.new(source.geometry, nearest.inputs["Mesh"])
    tree.links.new(value, nearest.inputs["Value"])
    if source.domain == "CORNER":
        tree.links.new(_inside_face(tree, share), nearest.inputs["Sample Position"])
    return nearest.outputs["Value"]


def _uvs_nearby(
    tree: bpy.types.NodeTree, source: _Source, value: bpy.types.NodeSocket, x: float
) -> bpy.types.NodeSocket:
    """UVs of the nearest surface.  Where a corner lies beside a seam, another chart may be nearer:
    then its face's middle, and what lies half way there, tell where its own chart goes on."""
    corner, half, middle = (_nearest(tree, source, value, x, share) for share in (PULL, 0.5, 1))
    on_chart = _node(tree, "ShaderNodeVectorMath", x, -1300, operation="SUBTRACT")
    tree.links.new(half, on_chart.inputs[0])
    tree.links.new(middle, on_chart.inputs[1])
    further = _node(tree, "ShaderNodeVectorMath", x, -1450, operation="MULTIPLY_ADD")
    further.inputs[1].default_value = (2, 2, 2)
    tree.links.new(on_chart.outputs[0], further.inputs[0])
    tree.links.new(middle, further.inputs[2])
    apart = _node(tree, "ShaderNodeVectorMath", x, -1600, operation="DISTANCE")
    tree.links.new(corner, apart.inputs[0])
    tree.links.new(further.outputs[0], apart.inputs[1])
    length = _node(tree, "ShaderNodeVectorMath", x, -1750, operation="LENGTH")
    tree.links.new(on_chart.outputs[0], length.inputs[0])
    bound = _node(tree, "ShaderNodeMath", x, -1900, operation="MULTIPLY")
    bound.inputs[1].default_value = ACROSS
    tree.links.new(length.outputs["Value"], bound.inputs[0])
    is_across = _node(tree, "ShaderNodeMath", x, -2050, operation="GREATER_THAN")
    tree.links.new(apart.outputs["Value"], is_across.inputs[0])
    tree.links.new(bound.outputs[0], is_across.inputs[1])
    switch = _node(tree, "GeometryNodeSwitch", x, -2200, input_type="VECTOR")
    tree.links.new(is_across.outputs[0], switch.inputs["Switch"])
    tree.links.new(corner, switch.inputs["False"])
    tree.links.new(further.outputs[0], switch.inputs["True"])
    return switch.outputs["Output"]


def _node(
    tree: bpy.types.NodeTree, kind: str, x: float, y: float, **settings: str
) -> bpy.types.Node:
    node = tree.nodes.new(kind)
    node.location = (x, y)
    for name, value in settings.items():
        setattr(node, name, value)
    return node
