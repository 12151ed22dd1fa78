"""Where a node group finds what is baked: in attributes of the mesh, or in the tiles of an atlas.

Tiles are read through one image, so that they are one sampler to EEVEE however many they are.  The
place is kept inside its tile by ``margin`` texels, and mixed here from four texels: EEVEE's own
filter takes a mip level by the step from pixel to pixel, which leaps where a chart ends, and finds
a mean of all tiles there.
"""

import bpy

from . import atlas_images
from .node_maths import Maths
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
        corners, shares = _four_texels(Maths(tree, 3), place, image.size[0] // columns)
        fours = [
            _tile(Maths(tree, 4 + row), image, corners, shares, (columns, rows), cell)
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


def _four_texels(
    make: Maths, place: Socket, size: int
) -> tuple[list[Socket], tuple[Socket, Socket]]:
    """The centres of the four texels about ``place``, of ``size`` a side, the lower two first, and
    how far it lies to the right and up between them."""
    texels = make.vector("MULTIPLY_ADD", place, float(size), (-0.5, -0.5, 0.0))
    texels = make.vector("MINIMUM", make.vector("MAXIMUM", texels, 0.0), float(size - 1))
    corner, part = make.vector("FLOOR", texels), make.vector("FRACTION", texels)
    right, up, _ = make.parts(part)
    centres = [
        make.vector("MULTIPLY_ADD", corner, 1 / size, ((i + 0.5) / size, (j + 0.5) / size, 0.0))
        for j in (0, 1)
        for i in (0, 1)
    ]
    return centres, (right, up)


def _tile(  # noqa: PLR0917 - a place, and a tile
    make: Maths,
    image: bpy.types.Image,
    centres: list[Socket],
    shares: tuple[Socket, Socket],
    grid: tuple[int, int],
    cell: tuple[int, int],
) -> Four:
    """Four floats at the place between ``centres``, of the tile in ``cell`` of the ``grid``,
    counted from below."""
    right, up = shares
    scale = (1 / grid[0], 1 / grid[1], 0.0)
    offset = (cell[0] / grid[0], cell[1] / grid[1], 0.0)
    nodes = []
    for centre in centres:
        node = make.node("ShaderNodeTexImage")
        node.image, node.interpolation, node.extension = image, "Closest", "EXTEND"
        make.tree.links.new(make.vector("MULTIPLY_ADD", centre, scale, offset), node.inputs[0])
        nodes.append(node)
    colours, alphas = ([node.outputs[k] for node in nodes] for k in ("Color", "Alpha"))
    below, above = (make.mixed(*colours[k : k + 2], right) for k in (0, 2))
    rows = [_mixed(make, *alphas[k : k + 2], right) for k in (0, 2)]
    return (*make.parts(make.mixed(below, above, up)), _mixed(make, *rows, up))


def _mixed(make: Maths, first: Socket, second: Socket, share: Socket) -> Socket:
    """From the number ``first`` to ``second``."""
    difference = make.scalar("SUBTRACT", second, first)
    return make.scalar("MULTIPLY_ADD", difference, share, first)


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


def _node(tree: bpy.types.NodeTree, kind: str, x: float, y: float) -> bpy.types.Node:
    node = tree.nodes.new(kind)
    node.location = (x, y)
    return node
