"""Bakes in textures: their atlas as pictures of the file, and the TEXCOORD_n that reads it.

Blender keeps an atlas in one image of tiles (``prt/tiles.py``); in glTF it is pictures of three
numbers each (``prt/files/byte_pairs.py``), turned to glTF's frame.
"""

from dataclasses import dataclass
from typing import Any

import bpy
import numpy as np
import numpy.typing as npt
from io_scene_gltf2.io.com import gltf2_io

from . import atlas_images, gltf_frame, uv_maps
from .gltf_attributes import Accessors
from .prt.files import byte_pairs
from .prt.files.png import png_bytes
from .prt.layout import Layout

ROWS = 128  # of an atlas, turned at a time
TEXCOORD = "TEXCOORD_"

Numbers = npt.NDArray[np.float64]


@dataclass(frozen=True)
class UvMap:
    """The map *PRT* of a mesh that is exported: TEXCOORD_``index``, the last one of ``count``;
    ``ours`` is whether the mesh says that a bake has made it."""

    index: int
    count: int
    ours: bool

    @property
    def name(self) -> str:
        """Of the attribute."""
        return f"{TEXCOORD}{self.index}"

    def without(self, attributes: Accessors) -> Accessors:
        """``attributes`` as they would be without the map.  One that others follow has to stay:
        the materials know these by their numbers."""
        if self.index + 1 < self.count:
            return attributes
        names = {self.name, "TANGENT"} if not self.index else {self.name}
        return {name: a for name, a in attributes.items() if name not in names}


def uv_map(mesh: bpy.types.Mesh) -> UvMap | None:
    """The map *PRT* of ``mesh``; None where it has none."""
    index = mesh.uv_layers.find(uv_maps.NAME)
    if index < 0:
        return None
    return UvMap(index, len(mesh.uv_layers), uv_maps.is_ours(mesh))


@dataclass(frozen=True)
class Pictures:
    """An atlas in a file: ``images`` of the exporter's hold the columns ``names``, whose values are
    ``offset + scale * number / 65535`` (K,)."""

    images: list[Any]
    names: tuple[str, ...]
    offset: Numbers
    scale: Numbers

    def shown(self, layout: Layout, share: float) -> dict[str, Any]:
        """``layout``, ``scale`` and ``offset`` of an object that shows what ``layout`` has, and a
        ``share`` of the residuals."""
        factors = np.array([share if name[:1] == "R" else 1.0 for name in self.names])
        names = [name if name in layout.slots else "" for name in self.names]
        unused = [0.0] * (byte_pairs.COLUMNS * len(self.images) - len(names))
        return {
            "layout": names + [""] * len(unused),
            "scale": (factors * self.scale).tolist() + unused,
            "offset": (factors * self.offset).tolist() + unused,
        }


class Atlases:
    """The atlases of one export, each written once."""

    def __init__(self, frame: gltf_frame.Float) -> None:
        self._frame = frame
        self._written: dict[bpy.types.Image, Pictures] = {}

    def of(self, image: bpy.types.Image, layout: Layout, binary: Any) -> Pictures:
        """``image``, whose columns are those of ``layout``; ``binary`` is the exporter's class of
        what goes into a buffer."""
        if image not in self._written:
            self._written[image] = _pictures(image, layout, self._frame, binary)
        return self._written[image]


def _pictures(
    image: bpy.types.Image, layout: Layout, frame: gltf_frame.Float, binary: Any
) -> Pictures:
    names = tuple(filter(None, layout.slots))
    values = atlas_images.columns(image, len(layout.attributes))[::-1]
    size, used = len(values), [k for k, name in enumerate(layout.slots) if name]
    turned = np.empty((size, size, len(names)), np.float32)
    for start in range(0, size, ROWS):
        rows = values[start : start + ROWS]
        flat = gltf_frame.turned(rows.reshape(-1, rows.shape[2]), layout, layout, 1.0, frame)
        turned[start : start + ROWS] = flat[:, used].reshape(*rows.shape[:2], len(used))
    offset, scale = byte_pairs.ranges(turned)
    images = [
        gltf2_io.Image(
            buffer_view=binary(png_bytes(picture)),
            extensions=None,
            extras=None,
            mime_type="image/png",
            name=f"{image.name} {k}",
            uri=None,
        )
        for k, picture in enumerate(byte_pairs.split(turned, offset, scale))
    ]
    return Pictures(images, names, offset, scale)
