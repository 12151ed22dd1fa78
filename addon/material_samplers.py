"""How many textures EEVEE binds for an artist's material: an atlas must fit beside them.

An image read in several nodes counts once for each way of filtering it.
"""

from collections.abc import Iterator

import bpy

from .material_attributes import nodes_of

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
    return {found for node in nodes_of(material) for found in _read_by(node)}


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
