"""What the artist chooses in File > Export > glTF, and the panel there."""

from collections.abc import Iterator
from contextlib import contextmanager

import bpy
import io_scene_gltf2

KEY = "PRT Baker"


def wants_short(scene: bpy.types.Scene) -> bool:
    """Whether bakes are to be written as 16-bit numbers."""
    chosen = getattr(scene, "prt", None)  # missing while the add-on is not registered
    return chosen is not None and bool(chosen.gltf_short)


@contextmanager
def chosen(scene: bpy.types.Scene, short: bool | None) -> Iterator[None]:
    """Inside, ``short`` is what the artist chose; None leaves it to him."""
    before = scene.prt.gltf_short
    if short is not None:
        scene.prt.gltf_short = short
    try:
        yield
    finally:
        scene.prt.gltf_short = before


def draw(context: bpy.types.Context, layout: bpy.types.UILayout) -> None:
    """A panel among those of the exporter."""
    header, body = layout.panel("PRT_baker", default_closed=False)
    header.label(text=KEY)
    if body is not None:
        body.use_property_split = True
        body.use_property_decorate = False
        body.prop(context.scene.prt, "gltf_short")


def register() -> None:
    """Let the exporter show it."""
    io_scene_gltf2.exporter_extension_layout_draw[KEY] = draw


def unregister() -> None:
    """Take it away."""
    del io_scene_gltf2.exporter_extension_layout_draw[KEY]
