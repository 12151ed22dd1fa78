"""The world as a source of light.

A colour, or an Environment Texture behind a Mapping that only rotates, is read as it is; any other
node tree is rendered once.  Reading the nodes is cheap enough for every redraw; pixels and packed
bytes are only touched by ``read`` and ``source``.
"""

from dataclasses import dataclass, field
from math import isfinite
from pathlib import Path

import bpy
import numpy as np
from mathutils import Euler

from . import world_images, world_render
from .prt.errors import BakeError
from .prt.job import IDENTITY, Array, LightSource, Vector

Rotation = tuple[Vector, Vector, Vector]
STRONGEST = 1e30  # of a world's strength: the sum over its pixels has to fit into float32
RENDERED = "rendered"  # the image_key of a world that had to be rendered
ROTATES = {"POINT", "VECTOR", "NORMAL", "TEXTURE"}


@dataclass(frozen=True)
class WorldLight:
    """``image_key`` names the image's content, "" where the world is a colour; ``follows`` is False
    where only another reading can tell what became of the world."""

    source: LightSource
    image_key: str
    follows: bool = True


@dataclass(frozen=True)
class SimpleWorld:
    """What the nodes of a world say that need not be rendered; fields as in ``LightSource``."""

    strength: Vector
    rotation: Rotation = IDENTITY
    image: bpy.types.Image | None = field(default=None, compare=False)
    image_key: str = ""


def read(scene: bpy.types.Scene, depsgraph: bpy.types.Depsgraph, folder: Path) -> WorldLight:
    """The light of ``scene``'s world, at the current frame.

    A packed image is written into ``folder``.  BakeError where there is no world or no image, or
    where nothing can be read.
    """
    simple = read_nodes(scene, depsgraph)
    if simple is None:
        pixels = world_render.render(scene)
        return WorldLight(LightSource(pixels=pixels), RENDERED, follows=False)
    return WorldLight(source(simple, folder), simple.image_key)


def from_file(path: str | Path) -> WorldLight:
    """Light of an .exr or .hdr, lat-long or cubemap, or of a folder with six faces."""
    image = Path(path).absolute()
    if not image.exists():
        raise BakeError(f"World image {str(path)!r} does not exist: give an .exr or .hdr")
    if image.is_file() and image.suffix.lower() not in world_images.DECODED:
        raise BakeError(f"World image {str(path)!r} is neither .exr nor .hdr: convert it first")
    return WorldLight(
        LightSource(image=str(image), may_be_cubemap=True), world_images.file_key(image)
    )


def source(simple: SimpleWorld, folder: Path) -> LightSource:
    """``simple`` with its pixels, or its file on disk."""
    image = simple.image
    if image is None:
        return LightSource(simple.strength)
    if world_images.in_memory(image):
        pixels = world_images.pixels(image)
        return LightSource(simple.strength, pixels=pixels, rotation=simple.rotation)
    packed = bool(image.packed_file)
    path = world_images.unpacked(image, folder) if packed else world_images.path(image)
    title = image.name if packed else ""
    return LightSource(simple.strength, str(path), rotation=simple.rotation, title=title)


def read_nodes(scene: bpy.types.Scene, depsgraph: bpy.types.Depsgraph) -> SimpleWorld | None:
    """What the nodes of ``scene``'s evaluated world say; None where they have to be rendered.

    Costs 0.15 ms.  BakeError where there is no light to read.
    """
    if scene.world is None:
        raise BakeError("The scene has no world: add one in World Properties")
    world = scene.world.evaluated_get(depsgraph)
    if bpy.app.version < (5, 0, 0) and not world.use_nodes:
        return SimpleWorld(tuple(world.color))
    output = world.node_tree.get_output_node("EEVEE")
    if output is None or not output.inputs["Surface"].is_linked:
        raise BakeError(f"World {world.name!r} has no light: link a Background to its World Output")
    background = _node_at(output.inputs["Surface"], "ShaderNodeBackground")
    if background is None or background.inputs["Strength"].is_linked:
        return None
    simple = _of_background(background, world.name)
    if simple is not None and not _is_usable(simple):
        raise BakeError(
            f"The strength or the rotation of world {world.name!r} is not finite: set it again"
        )
    return simple


def _of_background(background: bpy.types.Node, name: str) -> SimpleWorld | None:
    strength = float(background.inputs["Strength"].default_value)
    color = background.inputs["Color"]
    if not color.is_linked:
        return SimpleWorld(_vector(strength * np.array(color.default_value)[:3]))
    texture = _node_at(color, "ShaderNodeTexEnvironment")
    return None if texture is None else _of_texture(texture, strength, name)


def _is_usable(simple: SimpleWorld) -> bool:
    """Whether its light can be turned and added up in float32."""
    turn = (value for row in simple.rotation for value in row)
    return all(map(isfinite, turn)) and all(abs(value) < STRONGEST for value in simple.strength)


def _of_texture(texture: bpy.types.Node, strength: float, name: str) -> SimpleWorld | None:
    image = texture.image
    if image is None:
        raise BakeError(f"The Environment Texture of world {name!r} has no image: open an HDRI")
    if texture.projection != "EQUIRECTANGULAR" or not _is_plain(texture.texture_mapping):
        return None
    rotation = _rotation(texture.inputs["Vector"])
    if rotation is None or not _is_linear(image):
        return None
    key = world_images.key(image)
    return None if key is None else SimpleWorld((strength,) * 3, rotation, image, key)


def _node_at(socket: bpy.types.NodeSocket, kind: str) -> bpy.types.Node | None:
    """The node of type ``kind`` that feeds ``socket``; None where it is another or is muted."""
    while socket.is_linked:
        link = socket.links[0]
        node = link.from_node
        if link.is_muted or node.mute:
            return None
        if node.bl_idname != "NodeReroute":
            return node if node.bl_idname == kind else None
        socket = node.inputs[0]
    return None


def _rotation(socket: bpy.types.NodeSocket) -> Rotation | None:
    """The matrix that ``socket``'s mapping is; None where it does more than turn directions."""
    if not socket.is_linked:
        return IDENTITY
    mapping = _node_at(socket, "ShaderNodeMapping")
    if mapping is None:
        return IDENTITY if _is_direction(socket) else None
    sockets = [s for s in mapping.inputs if s.enabled]
    if any(s.is_linked for s in sockets[1:]) or not _is_direction(sockets[0]):
        return None
    values = {s.name: tuple(s.default_value) for s in sockets[1:]}
    if any(values.get("Location", ())) or values["Scale"] != (1, 1, 1):
        return None
    turn = np.array(Euler(values["Rotation"], "XYZ").to_matrix(), np.float64)
    if mapping.vector_type == "TEXTURE":
        turn = turn.T
    return _vector(turn[0]), _vector(turn[1]), _vector(turn[2])


def _is_direction(socket: bpy.types.NodeSocket) -> bool:
    coordinates = _node_at(socket, "ShaderNodeTexCoord")
    return coordinates is not None and _output_name(socket) == "Generated"


def _output_name(socket: bpy.types.NodeSocket) -> str:
    while socket.links[0].from_node.bl_idname == "NodeReroute":
        socket = socket.links[0].from_node.inputs[0]
    return str(socket.links[0].from_socket.name)


def _is_plain(mapping: bpy.types.TexMapping) -> bool:
    """Whether the mapping inside of a texture node, which the interface hides, is idle."""
    axes = mapping.mapping_x, mapping.mapping_y, mapping.mapping_z
    clipped = mapping.use_min or mapping.use_max
    moved = any(mapping.translation) or any(mapping.rotation) or tuple(mapping.scale) != (1, 1, 1)
    return axes == ("X", "Y", "Z") and not clipped and not moved


def _is_linear(image: bpy.types.Image) -> bool:
    """Whether its stored numbers are what a render works with."""
    space = getattr(bpy.data, "colorspace", None)  # a file has a working space since 5.0
    working = space.working_space if space else "Linear Rec.709"
    return image.colorspace_settings.name in {"Non-Color", working}


def _vector(values: Array) -> Vector:
    x, y, z = (float(value) for value in values)
    return x, y, z
