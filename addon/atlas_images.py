"""The image that shows an atlas, and what it says of itself: ``image["prt_atlas"]`` (JSON)."""

import json
from dataclasses import asdict, dataclass
from pathlib import Path

import bpy
import numpy as np
import numpy.typing as npt

from .prt.errors import BakeError
from .prt.tiles import tile_grid

TAG = "prt_atlas"
DIRECT = "prt_direct"  # on an atlas: the image that has it without light that bounced
Floats = npt.NDArray[np.float32]


@dataclass(frozen=True)
class Atlas:
    """``size`` texels a side; no surface lies nearer to its border than ``margin`` texels, and a
    filter may read up to there; ``job_hash`` names the bake whose file it is."""

    size: int
    margin: float
    job_hash: str


def load(path: Path, name: str, atlas: Atlas) -> bpy.types.Image:
    """A new image of the file at ``path``, as data: no colour space, no half precision.  An image
    of that name keeps it, and this one gets another."""
    image = bpy.data.images.load(str(path), check_existing=False)
    image.name = name
    _as_data(image, atlas)
    if 0 in image.size or not (image.has_data and image.is_float):
        bpy.data.images.remove(image)
        raise BakeError(f"Blender cannot read the image {path}: bake again")
    return image


def make(values: Floats, name: str, atlas: Atlas) -> bpy.types.Image:
    """A new image, packed into the .blend, of ``values`` (N, N, 4 k), row 0 at the bottom."""
    size, count = len(values), values.shape[2] // 4
    across, down = tile_grid(count)
    pixels = np.zeros((down * size, across * size, 4), np.float32)
    for k in range(count):
        row, column = (down - 1 - k // across) * size, (k % across) * size
        tile = values[:, :, 4 * k : 4 * k + 4]
        pixels[row : row + size, column : column + size] = tile
    image = bpy.data.images.new(name, across * size, down * size, alpha=True, float_buffer=True)
    _as_data(image, atlas)
    image.pixels.foreach_set(pixels.ravel())
    image.update()
    image.pack()
    return image


def _as_data(image: bpy.types.Image, atlas: Atlas) -> None:
    """No colour space, no half precision."""
    image.colorspace_settings.name = "Non-Color"
    image.alpha_mode = "CHANNEL_PACKED"
    image.use_half_precision = False
    image[TAG] = json.dumps(asdict(atlas))


def of(image: bpy.types.Image) -> Atlas | None:
    """What ``image`` says of itself; None where it is none of ours."""
    text = image.get(TAG)
    return Atlas(**json.loads(text)) if isinstance(text, str) else None


def columns(image: bpy.types.Image, count: int) -> Floats:
    """All that an atlas of ``count`` tiles holds: (N, N, 4 ``count``), row 0 at the bottom."""
    width, height = image.size
    pixels = np.empty(width * height * 4, np.float32)
    image.pixels.foreach_get(pixels)
    pixels = pixels.reshape(height, width, 4)
    across, down = tile_grid(count)
    size = width // across
    found = np.empty((size, size, 4 * count), np.float32)
    for k in range(count):
        row, column = (down - 1 - k // across) * size, (k % across) * size
        found[:, :, 4 * k : 4 * k + 4] = pixels[row : row + size, column : column + size]
    return found


def margin(image: bpy.types.Image) -> float:
    """How far from the border of a tile it is read, as a share of the tile's side."""
    atlas = of(image)
    return atlas.margin / atlas.size if atlas else 0.0


def both(image: bpy.types.Image) -> list[bpy.types.Image]:
    """The atlas ``image``, and the one without light that bounced where that was kept."""
    direct = image.get(DIRECT)
    return [image] if direct is None else [image, direct]


def set_direct(image: bpy.types.Image, direct: bpy.types.Image) -> None:
    """Let ``direct`` be the atlas ``image`` without light that bounced."""
    image[DIRECT] = direct


def free_unused() -> None:
    """Delete the atlases that nothing shows, and then what these alone had."""
    while unused := [image for image in bpy.data.images if TAG in image and not image.users]:
        for image in unused:
            bpy.data.images.remove(image)
