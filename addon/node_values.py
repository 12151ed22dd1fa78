"""Where a node group finds what is baked: in attributes of the mesh, or in the tiles of an atlas.

Tiles are read through one image, so that they are one sampler to EEVEE however many they are.  The
place is kept inside its tile by ``margin`` texels: there a filter reads no neighbouring tile.
"""

import bpy

from . import atlas_images
from .prt.layout import Layout
from .prt.tiles import tile_grid
from .uv_maps import NAME

Socket = bpy.types.NodeSocket
Four = tuple[Socket, Socket, Socket, Socket]


def floats(tree: bpy.types.NodeTree, layout: Layout, image: bpy.types.Image | None) -> list[Socket]:
    """Every float that ``layout`` uses, of attributes, or of ``image`` where there is one.  An
    alpha that is not used stays unread: where an attribute is missing it is 1."""
    if image is None:
        fours = [_attribute(tree, name, row) for row, name in enumerate(layout.attributes)]
    else:
        place = _inside_tile(tree, atlas_images.margin(image))
        columns, rows = tile_grid(len(layout.attributes))
        cells = [(k % columns, rows - 1 - k // columns) for k in range(len(layout.attributes))]
        fours = [
            _tile(tree, image, _scaled(tree, place, (columns, rows), cell, row), row)
            for row, cell in enumerate(cells)
        ]
    return [
        socket
        for socket, name in zip((s for four in fours for s in four), layout.slots, strict=True)
        if name
    ]


def _attribute(tree: bpy.types.NodeTree, name: str, row: int) -> Four:
    """Four floats of a colour attribute."""
    node = _node(tree, "ShaderNodeAttribute", -700, -220 * row)
    node.attribute_type, node.attribute_name = "GEOMETRY", name
    return _four(tree, node.outputs["Vector"], node.outputs["Alpha"], row)


def _tile(tree: bpy.types.NodeTree, image: bpy.types.Image, place: Socket, row: int) -> Four:
    """Four floats of the tile in which ``place`` is."""
    node = _node(tree, "ShaderNodeTexImage", -800, -300 * row)
    node.image, node.interpolation, node.extension = image, "Linear", "EXTEND"
    tree.links.new(place, node.inputs["Vector"])
    return _four(tree, node.outputs["Color"], node.outputs["Alpha"], row)


def _four(tree: bpy.types.NodeTree, three: Socket, alpha: Socket, row: int) -> Four:
    separate = _node(tree, "ShaderNodeSeparateXYZ", -500, -220 * row)
    tree.links.new(three, separate.inputs[0])
    return (*separate.outputs, alpha)


def _inside_tile(tree: bpy.types.NodeTree, margin: float) -> Socket:
    """The place in the atlas (u, v, 0), ``margin`` of its side away from its border."""
    place = _node(tree, "ShaderNodeUVMap", -1600, 0)
    place.uv_map = NAME
    socket = place.outputs["UV"]
    for step, (operation, bound) in enumerate((("MAXIMUM", margin), ("MINIMUM", 1 - margin))):
        node = _node(tree, "ShaderNodeVectorMath", -1400 + 180 * step, 0)
        node.operation = operation
        node.inputs[1].default_value = (bound, bound, 0)
        tree.links.new(socket, node.inputs[0])
        socket = node.outputs[0]
    return socket


def _scaled(
    tree: bpy.types.NodeTree, place: Socket, grid: tuple[int, int], cell: tuple[int, int], row: int
) -> Socket:
    """``place`` in the picture, for the tile in ``cell`` of the ``grid``, counted from below."""
    node = _node(tree, "ShaderNodeVectorMath", -1000, -300 * row)
    node.operation = "MULTIPLY_ADD"
    node.inputs[1].default_value = (1 / grid[0], 1 / grid[1], 0)
    node.inputs[2].default_value = (cell[0] / grid[0], cell[1] / grid[1], 0)
    tree.links.new(place, node.inputs[0])
    return node.outputs[0]


def _node(tree: bpy.types.NodeTree, kind: str, x: float, y: float) -> bpy.types.Node:
    node = tree.nodes.new(kind)
    node.location = (x, y)
    return node
