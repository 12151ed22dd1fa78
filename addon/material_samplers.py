"""How many textures EEVEE binds for an artist's material: an atlas must fit beside them.

An image read in several nodes counts once for each way of filtering it.
"""

from collections.abc import Iterator

import bpy

from . import material_plan
from .material_plan import SHADING, TAG

MOST = 30  # in one material; Blender 4 takes two more
RAMPS = (
    "ShaderNodeValToRGB",
    "ShaderNodeRGBCurve",
    "ShaderNodeVectorCurve",
    "ShaderNodeFloatCurve",
)
IMAGES = ("ShaderNodeTexImage", "ShaderNodeTexEnvironment")

Sampler = tuple[str, ...]


def of(material: bpy.types.Material) -> set[Sampler]:
    """What the artist's own shader in ``material`` samples, ours left out."""
    tree = material.node_tree
    output = material_plan.artist_output(tree) if tree else None
    return set(_behind(output, set())) if output is not None else set()


def _behind(node: bpy.types.Node, seen: set[bpy.types.Node]) -> Iterator[Sampler]:
    """The samplers of ``node`` and of every node that leads to it."""
    if node in seen or node.get(TAG) == SHADING:
        return
    seen.add(node)
    yield from _read_by(node)
    if node.type == "GROUP" and node.node_tree is not None:
        for inner in node.node_tree.nodes:
            if inner.type == "GROUP_OUTPUT" and inner.is_active_output:
                yield from _behind(inner, seen)
    for socket in node.inputs:
        for link in socket.links:
            yield from _behind(link.from_node, seen)


def _read_by(node: bpy.types.Node) -> Iterator[Sampler]:
    """The samplers of ``node`` itself."""
    kind = node.bl_idname
    if kind in IMAGES and node.image is not None:
        clip = getattr(node, "extension", "")
        yield node.image.name_full, node.interpolation, clip
        if node.image.source == "TILED":  # and where its tiles are
            yield node.image.name_full, "tiles"
    elif kind in RAMPS:
        yield ("ramps",)
    elif kind in ("ShaderNodeTexSky", "ShaderNodeTexIES"):
        yield kind, node.name
