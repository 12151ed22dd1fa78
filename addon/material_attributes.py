"""How many vertex attributes EEVEE reads for an artist's material: the bake must fit beside them.

Each distinct one counts once.  What shares and what doesn't was found by filling materials up to
EEVEE's bound (Blender 4.5 and 5.2): a UV map, an attribute and a colour attribute of one name are
one; the active UV map counts apart from the same map by its name; a Texture Coordinate node always
reads the active UV map, whichever of its outputs is used.
"""

from collections.abc import Iterator

import bpy

from . import material_plan
from .material_plan import SHADING, TAG

Attribute = tuple[str, str]  # what kind, which one
UV: Attribute = ("named", "")  # the active one
GENERATED: Attribute = ("generated", "")
GENERATED_UNLESS_LINKED = (
    "ShaderNodeTexNoise",
    "ShaderNodeTexVoronoi",
    "ShaderNodeTexWave",
    "ShaderNodeTexMagic",
    "ShaderNodeTexChecker",
    "ShaderNodeTexBrick",
    "ShaderNodeTexGradient",
    "ShaderNodeTexGabor",
    "ShaderNodeTexSky",
)


def of(material: bpy.types.Material) -> set[Attribute]:
    """What the artist's own shader in ``material`` reads, ours left out."""
    return {found for node in nodes_of(material) for found in _read_by(node)}


def nodes_of(material: bpy.types.Material) -> Iterator[bpy.types.Node]:
    """Every node that leads to the artist's own output in ``material``, those in groups too."""
    tree = material.node_tree
    output = material_plan.artist_output(tree) if tree else None
    return _behind(output, set()) if output is not None else iter(())


def _behind(node: bpy.types.Node, seen: set[bpy.types.Node]) -> Iterator[bpy.types.Node]:
    """``node`` and every node that leads to it, ours left out."""
    if node in seen or node.get(TAG) == SHADING:
        return
    seen.add(node)
    yield node
    if node.type == "GROUP" and node.node_tree is not None:
        for inner in node.node_tree.nodes:
            if inner.type == "GROUP_OUTPUT" and inner.is_active_output:
                yield from _behind(inner, seen)
    for socket in node.inputs:
        for link in socket.links:
            yield from _behind(link.from_node, seen)


def _read_by(node: bpy.types.Node) -> Iterator[Attribute]:
    """The attributes that ``node`` reads itself."""
    kind = node.bl_idname
    if kind == "ShaderNodeTexImage" and not _is_mapped(node):
        yield UV
    elif kind in GENERATED_UNLESS_LINKED and not _is_mapped(node):
        yield GENERATED
    elif kind == "ShaderNodeTexCoord":
        yield UV
        yield from [GENERATED] * node.outputs["Generated"].is_linked
    elif kind == "ShaderNodeNewGeometry":
        yield from [GENERATED] * node.outputs["Tangent"].is_linked
    elif kind == "ShaderNodeVectorDisplacement":
        yield from [("tangent", "")] * (node.space == "TANGENT")
    else:
        yield from _named_by(node)


def _is_mapped(texture: bpy.types.Node) -> bool:
    """Whether its coordinates are linked; a physical sky has no such input."""
    return any(socket.is_linked for socket in texture.inputs if socket.name == "Vector")


def _named_by(node: bpy.types.Node) -> Iterator[Attribute]:
    """The attributes whose names are properties of ``node``."""
    kind = node.bl_idname
    if kind == "ShaderNodeUVMap":
        yield "named", node.uv_map
    elif kind == "ShaderNodeAttribute" and node.attribute_type == "GEOMETRY":
        yield "named", node.attribute_name
    elif kind == "ShaderNodeVertexColor":
        yield ("named" if node.layer_name else "colour"), node.layer_name
    elif kind == "ShaderNodeNormalMap" and node.space == "TANGENT":
        yield "tangent", node.uv_map
    elif kind == "ShaderNodeTangent":
        yield GENERATED if node.direction_type == "RADIAL" else ("tangent", node.uv_map)
