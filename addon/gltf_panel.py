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


def wanted_error(scene: bpy.types.Scene) -> float:
    """The relative error that compressed bakes may have; 0 where they are not to be compressed."""
    chosen = getattr(scene, "prt", None)
    return chosen.gltf_error / 100 if chosen is not None and chosen.gltf_compress else 0.0


def wants_ibl(scene: bpy.types.Scene) -> bool:
    """Whether stock viewers are to be lit by the worlds."""
    chosen = getattr(scene, "prt", None)
    return chosen is not None and bool(chosen.gltf_ibl)


@contextmanager
def chosen(
    scene: bpy.types.Scene,
    short: bool | None,
    error: float | None = None,
    ibl: bool | None = None,
) -> Iterator[None]:
    """Inside, ``short``, compression with ``error`` and ``ibl`` are what the artist chose; None
    leaves it to him."""
    names = ("gltf_short", "gltf_compress", "gltf_error", "gltf_ibl")
    before = [getattr(scene.prt, name) for name in names]
    wanted = (short, error and True, error and 100 * error, ibl)
    for name, value in zip(names, wanted, strict=True):
        if value is not None:
            setattr(scene.prt, name, value)
    try:
        yield
    finally:
        for name, value in zip(names, before, strict=True):
            setattr(scene.prt, name, value)


def draw(context: bpy.types.Context, layout: bpy.types.UILayout) -> None:
    """A panel among those of the exporter."""
    header, body = layout.panel("PRT_baker", default_closed=False)
    header.label(text=KEY)
    if body is not None:
        body.use_property_split = True
        body.use_property_decorate = False
        settings = context.scene.prt
        short = body.row()
        short.active = not settings.gltf_compress
        short.prop(settings, "gltf_short")
        body.prop(settings, "gltf_compress")
        error = body.row()
        error.active = settings.gltf_compress
        error.prop(settings, "gltf_error")
        body.prop(settings, "gltf_ibl")


def register() -> None:
    """Let the exporter show it."""
    io_scene_gltf2.exporter_extension_layout_draw[KEY] = draw


def unregister() -> None:
    """Take it away."""
    del io_scene_gltf2.exporter_extension_layout_draw[KEY]
