"""Pictures that people look at, as files."""

from pathlib import Path

import bpy
import numpy as np
from picture_truth import Mask, Picture, Truth

STRETCH = 4  # of the differences, which could not be seen otherwise
WHITE_AT = 98  # percentile of Cycles' picture


def compare(path: Path, shown: Picture, truth: Truth, covered: Mask) -> None:
    """What EEVEE shows, what Cycles does, and their difference made visible, side by side."""
    mean = (truth.first + truth.second) / 2
    scale = 0.9 / float(np.percentile(mean[covered], WHITE_AT))
    difference = STRETCH * np.abs(shown - mean) * covered[..., None]
    panels = [panel * scale for panel in (shown, mean, difference)]
    save(path, np.hstack(panels))


def save(path: Path, linear: Picture) -> None:
    """``linear`` (H, W, 3), top row first, in the standard view, as .png or .jpg."""
    height, width = linear.shape[:2]
    image = bpy.data.images.new(path.stem, width, height, float_buffer=True)
    pixels = np.ones((height, width, 4), np.float32)
    pixels[..., :3] = linear[::-1]
    image.pixels.foreach_set(pixels.ravel())
    scene = bpy.context.scene
    scene.view_settings.view_transform = "Standard"
    settings = scene.render.image_settings
    if bpy.app.version >= (5, 0):
        settings.media_type = "IMAGE"
    settings.file_format = "JPEG" if path.suffix == ".jpg" else "PNG"
    settings.color_depth, settings.quality = "8", 92
    image.save_render(str(path.absolute()), scene=scene)
    bpy.data.images.remove(image)
