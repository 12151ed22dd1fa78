"""The geometry nodes that store a carrier's values on the object that wears the modifier."""

import json
from dataclasses import dataclass

import bpy

from .prt.layout import PREFIX

TAG = "prt_carrier_group"
PULL = 0.01  # of the way from a corner to the middle of its face
COUNTS = {"POINT": "Point Count", "CORNER": "Face Corner Count"}


def group(domain: str, count: int) -> bpy.types.NodeTree:
    """The group that stores ``count`` attributes on ``domain``; all objects alike share it."""
    key = json.dumps([domain, count])
    for tree in bpy.data.node_groups:
        if tree.get(TAG) == key:
            return tree
    return _build(domain, count, key)


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
    """Where the values come from: the carrier's geometry, a number above 0 where it has not as
    many elements of ``domain`` as what is shown, and where to look for its nearest surface, which
    is the element's own place where that is None."""

    domain: str
    geometry: bpy.types.NodeSocket
    differ: bpy.types.NodeSocket
    place: bpy.types.NodeSocket | None


def _build(domain: str, count: int, key: str) -> bpy.types.NodeTree:
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
    place = _inside_face(tree) if domain == "CORNER" else None
    source = _Source(domain, carrier, differ, place)
    for column in range(count):
        geometry = _stored(tree, geometry, source, column)
    outside = _node(tree, "NodeGroupOutput", 300 + 220 * count, 0)
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


def _inside_face(tree: bpy.types.NodeTree) -> bpy.types.NodeSocket:
    """A corner's place pulled a little into its face, so that the nearest surface is not the one
    across a sharp edge."""
    position = _node(tree, "GeometryNodeInputPosition", -900, -800)
    centre = _node(tree, "GeometryNodeFieldOnDomain", -700, -900, data_type="FLOAT_VECTOR")
    centre.domain = "FACE"
    towards = _node(tree, "ShaderNodeVectorMath", -500, -900, operation="SUBTRACT")
    pulled = _node(tree, "ShaderNodeVectorMath", -300, -800, operation="MULTIPLY_ADD")
    pulled.inputs[1].default_value = (PULL,) * 3
    tree.links.new(position.outputs[0], centre.inputs["Value"])
    tree.links.new(centre.outputs[0], towards.inputs[0])
    tree.links.new(position.outputs[0], towards.inputs[1])
    tree.links.new(towards.outputs[0], pulled.inputs[0])
    tree.links.new(position.outputs[0], pulled.inputs[2])
    return pulled.outputs[0]


def _stored(
    tree: bpy.types.NodeTree, geometry: bpy.types.NodeSocket, source: _Source, column: int
) -> bpy.types.NodeSocket:
    """``geometry`` with attribute number ``column`` of the source on it."""
    store = _node(tree, "GeometryNodeStoreNamedAttribute", 220 * column, 200)
    store.data_type, store.domain = "FLOAT_COLOR", source.domain
    store.inputs["Name"].default_value = f"{PREFIX}{column}"
    tree.links.new(geometry, store.inputs["Geometry"])
    tree.links.new(_sampled(tree, source, column), store.inputs["Value"])
    return store.outputs["Geometry"]


def _sampled(tree: bpy.types.NodeTree, source: _Source, column: int) -> bpy.types.NodeSocket:
    """The source's attribute: by index, or from its nearest surface."""
    x = 220 * column
    named = _node(tree, "GeometryNodeInputNamedAttribute", x, -1100, data_type="FLOAT_COLOR")
    named.inputs["Name"].default_value = f"{PREFIX}{column}"
    by_index = _node(tree, "GeometryNodeSampleIndex", x, -550, data_type="FLOAT_COLOR")
    by_index.domain = source.domain
    index = _node(tree, "GeometryNodeInputIndex", x, -450)
    nearest = _node(tree, "GeometryNodeSampleNearestSurface", x, -800, data_type="FLOAT_COLOR")
    switch = _node(tree, "GeometryNodeSwitch", x, -200, input_type="RGBA")
    tree.links.new(index.outputs["Index"], by_index.inputs["Index"])
    tree.links.new(source.geometry, by_index.inputs["Geometry"])
    tree.links.new(source.geometry, nearest.inputs["Mesh"])
    if source.place is not None:
        tree.links.new(source.place, nearest.inputs["Sample Position"])
    for sampler in (by_index, nearest):
        tree.links.new(named.outputs["Attribute"], sampler.inputs["Value"])
    tree.links.new(source.differ, switch.inputs["Switch"])
    tree.links.new(by_index.outputs["Value"], switch.inputs["False"])
    tree.links.new(nearest.outputs["Value"], switch.inputs["True"])
    return switch.outputs["Output"]


def _node(
    tree: bpy.types.NodeTree, kind: str, x: float, y: float, **settings: str
) -> bpy.types.Node:
    node = tree.nodes.new(kind)
    node.location = (x, y)
    for name, value in settings.items():
        setattr(node, name, value)
    return node
