"""The image that shows an atlas, and what it says of itself: ``image["prt_atlas"]`` (JSON)."""

import json
from dataclasses import asdict, dataclass
from pathlib import Path

import bpy

from .prt.errors import BakeError

TAG = "prt_atlas"


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
    image.colorspace_settings.name = "Non-Color"
    image.alpha_mode = "CHANNEL_PACKED"
    image.use_half_precision = False
    image[TAG] = json.dumps(asdict(atlas))
    if 0 in image.size or not (image.has_data and image.is_float):
        bpy.data.images.remove(image)
        raise BakeError(f"Blender cannot read the image {path}: bake again")
    return image


def of(image: bpy.types.Image) -> Atlas | None:
    """What ``image`` says of itself; None where it is none of ours."""
    text = image.get(TAG)
    return Atlas(**json.loads(text)) if isinstance(text, str) else None


def margin(image: bpy.types.Image) -> float:
    """How far from the border of a tile it is read, as a share of the tile's side."""
    atlas = of(image)
    return atlas.margin / atlas.size if atlas else 0.0


def free_unused() -> None:
    """Delete the atlases that nothing shows."""
    for image in [image for image in bpy.data.images if TAG in image and not image.users]:
        bpy.data.images.remove(image)
