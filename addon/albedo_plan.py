"""What a material's diffuse reflectance is, read from the artist's nodes.

Sums of Principled and Diffuse closures whose colours are constants, pictures or colour attributes
can be read; anything else has to be baked by Cycles.  Light that metal or glass reflects or lets
through is not diffuse and does not count.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import bpy

from . import default_surface, material_plan

Rgb = tuple[float, float, float]

NO_MATERIAL: Rgb = (0.8, 0.8, 0.8)  # what Cycles shows
BLACK_SHADERS = {"EMISSION", "BSDF_TRANSPARENT", "HOLDOUT", "BSDF_GLASS", "BSDF_REFRACTION"}
PICTURES = {"FILE", "GENERATED"}
LAID = {"REPEAT", "EXTEND"}


@dataclass(frozen=True)
class Color:
    """A colour: ``value``, times ``image`` (a name) seen through the UV map ``layer``, or the
    colour attribute ``layer``; "" is the active one."""

    value: Rgb = (1.0, 1.0, 1.0)
    kind: str = "constant"  # or "image", "attribute"
    layer: str = ""
    image: str = ""
    extends: bool = False


@dataclass(frozen=True)
class Plan:
    """Diffuse reflectance, the sum of ``colors`` times their weights; None where it is not known.
    ``emits`` is whether the material shines by itself."""

    colors: tuple[tuple[float, Color], ...] | None
    emits: bool = False


def read(material: bpy.types.Material | None) -> Plan:
    """The plan of ``material``, as Cycles shows it."""
    if material is None:
        return Plan(((1.0, Color(NO_MATERIAL)),))
    if not default_surface.has_nodes(material):
        return Plan(((1.0, Color(tuple(material.diffuse_color[:3]))),))
    tree = material.node_tree
    output = tree.get_output_node("CYCLES")
    surface = material_plan.shader_origin(output.inputs["Surface"]) if output else None
    try:
        colors = tuple(_sum(surface, frozenset()))
    except _UnknownError:
        return Plan(None, _emits(surface, frozenset()))
    return Plan(colors, _emits(surface, frozenset()))


class _UnknownError(Exception):
    """Nodes that cannot be read."""


def _sum(
    socket: bpy.types.NodeSocket | None, above: frozenset[str]
) -> Iterator[tuple[float, Color]]:
    """The diffuse colours of a shader and their weights; ``above`` holds the nodes on the way."""
    if socket is None:
        return
    node = socket.node
    if node.name in above:
        raise _UnknownError
    above |= {node.name}
    if node.type == "BSDF_DIFFUSE":
        yield 1.0, _color(node.inputs["Color"])
    elif node.type == "BSDF_PRINCIPLED":
        diffuse = (1 - _number(node.inputs["Metallic"])) * (
            1 - _number(node.inputs["Transmission Weight"])
        )
        if diffuse > 0:
            yield diffuse, _color(node.inputs["Base Color"])
    elif node.type in {"MIX_SHADER", "ADD_SHADER"}:
        shaders = [s for s in node.inputs if s.type == "SHADER"]
        share = _number(node.inputs[0]) if node.type == "MIX_SHADER" else 1.0
        weights = (1 - share, share) if node.type == "MIX_SHADER" else (1.0, 1.0)
        for weight, shader in zip(weights, shaders, strict=True):
            if weight > 0:
                parts = _sum(material_plan.shader_origin(shader), above)
                yield from ((weight * part, color) for part, color in parts)
    elif node.type not in BLACK_SHADERS:
        raise _UnknownError


def _number(socket: bpy.types.NodeSocket) -> float:
    if _link(socket) is not None:
        raise _UnknownError
    return min(1.0, max(0.0, float(socket.default_value)))


def _link(socket: bpy.types.NodeSocket) -> bpy.types.NodeLink | None:
    return socket.links[0] if socket.links and not socket.links[0].is_muted else None


def _color(socket: bpy.types.NodeSocket) -> Color:
    origin = material_plan.shader_origin(socket)
    if origin is None:
        return Color(tuple(socket.default_value[:3]))
    node = origin.node
    if origin.name != "Color":
        raise _UnknownError
    if node.type == "RGB":
        return Color(tuple(origin.default_value[:3]))
    if node.type == "VERTEX_COLOR":
        return Color(kind="attribute", layer=node.layer_name)
    if node.type == "ATTRIBUTE" and node.attribute_type == "GEOMETRY" and node.attribute_name:
        return Color(kind="attribute", layer=node.attribute_name)
    if node.type == "TEX_IMAGE":
        return _picture(node)
    raise _UnknownError


def _picture(node: bpy.types.Node) -> Color:
    image = node.image
    if image is None:
        return Color((0.0, 0.0, 0.0))
    flat = node.projection == "FLAT" and node.extension in LAID
    if not flat or image.source not in PICTURES or image.file_format in {"OPEN_EXR", "HDR"}:
        raise _UnknownError
    return Color(
        kind="image",
        layer=_uv_layer(node.inputs["Vector"]),
        image=image.name,
        extends=node.extension == "EXTEND",
    )


def _uv_layer(socket: bpy.types.NodeSocket) -> str:
    """The UV map that a picture is laid by; "" for the one that renders use."""
    origin = material_plan.shader_origin(socket)
    if origin is None:
        return ""
    node = origin.node
    if node.type == "UVMAP" and not node.from_instancer:
        return str(node.uv_map)
    if node.type == "TEX_COORD" and origin.name == "UV" and not node.from_instancer:
        return ""
    raise _UnknownError


def _emits(socket: bpy.types.NodeSocket | None, above: frozenset[str]) -> bool:
    """Whether a shader shines, as far as can be seen without its links."""
    if socket is None or socket.node.name in above:
        return False
    node, above = socket.node, above | {socket.node.name}
    if node.type in {"MIX_SHADER", "ADD_SHADER"}:
        shaders = (material_plan.shader_origin(s) for s in node.inputs if s.type == "SHADER")
        return any(_emits(shader, above) for shader in shaders)
    names = {"EMISSION": ("Color", "Strength"), "BSDF_PRINCIPLED": ("Emission Color",
             "Emission Strength")}.get(node.type)  # fmt: skip
    if names is None:
        return False
    color, strength = (node.inputs[name] for name in names)
    shines = _link(strength) is not None or strength.default_value > 0
    return shines and (_link(color) is not None or any(color.default_value[:3]))
