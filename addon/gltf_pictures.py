"""Bakes in pictures of a glTF file that is imported: their numbers, their UVs, and their atlas."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import bpy
import numpy as np
import numpy.typing as npt
from io_scene_gltf2.io.imp.gltf2_io_binary import BinaryData

from . import atlas_images, gltf_frame
from .gltf_extras import FileBake
from .prt import layout as layouts
from .prt.errors import BakeError
from .prt.files import byte_pairs
from .prt.layout import Layout
from .prt.results import InAtlas, ReceiverResult

NAME = "PRT Atlas"
MARGIN = 0.5  # texels; the least that a filter needs
ROWS = 128  # of an atlas, turned at a time

Floats = npt.NDArray[np.float32]
Bytes = npt.NDArray[np.uint8]


@dataclass(frozen=True)
class FileAtlas:
    """What an object shows of ``bake``: ``layout`` of it, turned by ``turn`` (3, 3) after the
    file's frame has become Blender's."""

    bake: FileBake
    layout: Layout
    turn: gltf_frame.Float

    @property
    def key(self) -> tuple[Any, ...]:
        """Names the numbers."""
        numbers = (self.bake.scale, self.bake.offset, self.turn)
        columns = (self.bake.images, self.bake.layout, self.bake.columns)
        direct = self.direct and self.direct.key
        return (*columns, self.layout, *(array.tobytes() for array in numbers), direct)

    @property
    def direct(self) -> "FileAtlas | None":
        """The same without bounces, where the file has that."""
        bake = self.bake.direct
        return None if bake is None else FileAtlas(bake, self.layout.direct, self.turn)


class Pictures:
    """Those of one file, each read once."""

    def __init__(self, gltf: Any) -> None:
        self._gltf = gltf
        self._read: dict[int, Bytes] = {}

    def check(self, bake: FileBake) -> None:
        """BakeError where one of ``bake`` cannot be used."""
        shapes = {self._picture(index).shape for index in bake.images}
        for height, width, _ in sorted(shapes):
            if (height, len(shapes)) != (2 * width, 1):
                raise BakeError(
                    f"a picture of the bake is {width} by {height}, and all have to be of one size "
                    "and twice as high as wide"
                )

    def atlas(self, atlas: "FileAtlas") -> bpy.types.Image:
        """``atlas``, packed into the .blend.  Any write of a bake deletes images that nothing
        shows, so make it when it is wanted."""
        image = self._image(atlas)
        if atlas.direct is not None:
            atlas_images.set_direct(image, self._image(atlas.direct))
        return image

    def _image(self, atlas: "FileAtlas") -> bpy.types.Image:
        bake = atlas.bake
        pictures = [self._picture(index) for index in bake.images]
        numbers = byte_pairs.joined(pictures, 0 * bake.offset, 0 * bake.scale + 1)
        values = _turned(bake.arranged(numbers)[::-1], bake.layout, atlas.layout, atlas.turn)
        return atlas_images.make(values, NAME, atlas_images.Atlas(len(values), MARGIN, ""))

    def size(self, bake: FileBake) -> int:
        """Texels along a side of its atlas."""
        return int(self._picture(bake.images[0]).shape[1])

    def _picture(self, index: int) -> Bytes:
        if index not in self._read:
            self._read[index] = _decoded(_file(self._gltf, index), index)
        return self._read[index]


def _turned(values: Floats, stored: Layout, layout: Layout, turn: gltf_frame.Float) -> Floats:
    """``values`` (N, N, 4 k) of ``stored``, Y up, as those of ``layout``, Z up."""
    found = np.empty((*values.shape[:2], len(layout.slots)), np.float32)
    frame = turn @ gltf_frame.Y_UP.T
    for start in range(0, len(values), ROWS):
        rows = values[start : start + ROWS]
        flat = gltf_frame.turned(rows.reshape(-1, rows.shape[2]), stored, layout, 1.0, frame)
        found[start : start + ROWS] = flat.reshape(*rows.shape[:2], -1)
    return found


def _file(gltf: Any, index: int) -> bytes:
    images = gltf.data.images or []
    data = BinaryData.get_image_data(gltf, index) if index < len(images) else None
    if data is None:
        raise BakeError(f"image {index} is not in the file")
    return bytes(data)


def _decoded(file: bytes, index: int) -> Bytes:
    """Pixels (H, W, 3), top row first, by Blender's own reader."""
    image = bpy.data.images.new("PRT picture", 8, 8)
    try:
        image.pack(data=file, data_len=len(file))
        image.source, image.colorspace_settings.name = "FILE", "Non-Color"
        width, height = image.size
        if not (width and height and image.has_data) or image.is_float:
            raise BakeError(f"image {index} is no picture of 8 bits")
        pixels = np.empty(4 * width * height, np.float32)
        image.pixels.foreach_get(pixels)
    finally:
        bpy.data.images.remove(image)
    shown = pixels.reshape(height, width, 4)[::-1, :, :3]
    return np.rint(255 * shown).astype(np.uint8)


def check_uvs(primitive: Any, bake: FileBake, gltf: Any) -> None:
    """BakeError where a triangle primitive lacks the UVs of ``bake``."""
    name = f"TEXCOORD_{bake.tex_coord}"
    if name not in primitive.attributes:
        raise BakeError(f"attribute {name} is missing")
    accessor = gltf.data.accessors[primitive.attributes[name]]
    vertices = gltf.data.accessors[primitive.attributes["POSITION"]].count
    if accessor.count != vertices:
        raise BakeError(f"attribute {name} has {accessor.count} values for {vertices} vertices")
    if not np.isfinite(BinaryData.decode_accessor_obj(gltf, accessor)).all():
        raise BakeError(f"attribute {name} has a value that is no number")


def take_uvs(mesh: bpy.types.Mesh, name: str) -> Floats:
    """The UV map ``name`` (C, 2) of ``mesh``, which loses it unless a material reads it."""
    layer = mesh.uv_layers.get(name)
    if layer is None:
        raise BakeError(f"{mesh.name} has no room for its UV map")
    uvs = np.empty(2 * len(mesh.loops), np.float32)
    layer.uv.foreach_get("vector", uvs)
    if not _is_read(mesh.materials, name, first=layer == mesh.uv_layers[0]):
        mesh.uv_layers.remove(layer)
    return uvs.reshape(-1, 2)


def result(name: str, layout: Layout, uvs: Floats) -> ReceiverResult:
    """The bake of an object whose values, of ``layout``, an atlas has at ``uvs``."""
    nothing = vars(layouts.unpack(layout, np.empty((0, len(layout.slots)), np.float32)))
    elements = np.empty(0, np.int32)
    return ReceiverResult(name, element_points=elements, in_atlas=InAtlas(0, uvs), **nothing)


def _is_read(materials: Sequence[bpy.types.Material | None], name: str, first: bool) -> bool:
    """Does a material read the UV map ``name``, the ``first`` one without saying so?"""
    nodes = [n for m in materials if m and m.node_tree for n in m.node_tree.nodes]
    named = any(node.type == "UVMAP" and node.uv_map == name for node in nodes)
    return named or (first and any(node.type == "TEX_IMAGE" for node in nodes))
