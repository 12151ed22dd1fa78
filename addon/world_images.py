"""The image of a world: what names its content, and where its pixels are.

Blender's readers of .exr and .hdr are left alone, for a damaged file can crash them: the engine
decodes those, in its own process.
"""

from pathlib import Path

import bpy
import numpy as np

from .prt.errors import BakeError
from .prt.job import Array

DECODED = (".exr", ".hdr")  # what the engine reads


def key(image: bpy.types.Image) -> str | None:
    """Names the content of ``image`` without looking at a pixel; None where it must be rendered.

    So neither painted pixels nor a packed image exchanged for one of the same size and name change
    it: for those there is Update Light.
    """
    if image.source == "GENERATED":
        return f"generated {image.name_full} {_generated(image)}"
    if image.source != "FILE" or image.type == "MULTILAYER":
        return None
    if image.is_dirty:
        return f"painted {image.name_full} {tuple(image.size)}"
    if not is_decoded(image):
        packed_float = image.packed_file and not image.filepath and image.is_float
        return f"packed {image.name_full} {image.packed_file.size}" if packed_float else None
    if image.packed_file:
        return f"packed {image.name_full} {image.packed_file.size}"
    try:
        return file_key(path(image))
    except OSError as error:
        raise missing(image) from error


def _generated(image: bpy.types.Image) -> tuple[object, ...]:
    size = image.generated_width, image.generated_height
    return image.generated_type, *size, *image.generated_color


def file_key(file: Path) -> str:
    """Names the content of a file."""
    status = file.stat()
    return f"file {file} {status.st_size} {status.st_mtime_ns}"


def missing(image: bpy.types.Image) -> BakeError:
    """What to say when there is no file at the path of ``image``."""
    return BakeError(
        f"The world's image {str(path(image))!r} is missing: find it or open another one"
    )


def path(image: bpy.types.Image) -> Path:
    """Where the file of ``image`` is."""
    return Path(bpy.path.abspath(image.filepath, library=image.library))


def is_decoded(image: bpy.types.Image) -> bool:
    """Whether the file of ``image`` is one for the engine, by its name."""
    return Path(image.filepath).suffix.lower() in DECODED


def in_memory(image: bpy.types.Image) -> bool:
    """Whether the pixels are Blender's own, and in no file."""
    return image.source == "GENERATED" or image.is_dirty


def pixels(image: bpy.types.Image) -> Array:
    """Pixels (H, W, 3) float32, top row first."""
    width, height = image.size
    if not width or not height:
        raise BakeError(f"The world's image {image.name!r} has no pixels: reload it")
    values = np.empty(width * height * image.channels, np.float32)
    image.pixels.foreach_get(values)
    rows = values.reshape(height, width, -1)[::-1]
    colors = rows[..., :3] if image.channels >= 3 else rows[..., :1].repeat(3, axis=-1)
    return np.ascontiguousarray(colors)


def unpacked(image: bpy.types.Image, folder: Path) -> Path:
    """A packed file as it was, written into ``folder``."""
    suffix = Path(image.filepath).suffix.lower()
    file = folder / f"world{suffix if suffix in DECODED else '.exr'}"
    file.write_bytes(image.packed_file.data)
    return file
