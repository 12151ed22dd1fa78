"""The image that shiny materials reflect, packed into the .blend: ``image["prt_reflections"]``
(JSON) says what lies where in it.  There is one for the file, as there is one light."""

import json
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from typing import Any

import bpy

from .prt.errors import BakeError
from .prt.job import Peak
from .prt.results import Reflections
from .prt.specular.sheet import Sheet

NAME = "PRT Reflections"
TAG = "prt_reflections"
FORMER = "prt_former_reflections"


@dataclass(frozen=True)
class Known:
    """What an image says of itself: where things are, which peaks are left out of it, in the
    picture's own frame and for a strength of 1, and the ``key`` of that picture."""

    sheet: Sheet
    peaks: tuple[Peak, ...]
    key: str

    def is_read_like(self, other: "Known") -> bool:
        """Whether the same nodes read both."""
        places = [(one.sheet.cell, one.sheet.detail) for one in (self, other)]
        radii = [[peak.angular_radius for peak in one.peaks] for one in (self, other)]
        return places[0] == places[1] and radii[0] == radii[1]


def current() -> bpy.types.Image | None:
    """The image of the file; None where nothing is reflected."""
    named = bpy.data.images.get(NAME)
    if named is not None and TAG in named:
        return named
    return next((image for image in bpy.data.images if TAG in image), None)


def of(image: bpy.types.Image) -> Known:
    """What ``image`` says of itself."""
    found: dict[str, Any] = json.loads(image[TAG])
    peaks = tuple(Peak.of(peak) for peak in found["peaks"])
    return Known(Sheet.of(found["sheet"]), peaks, found["key"])


@contextmanager
def loaded(found: Reflections | None, key: str) -> Iterator[bpy.types.Image | None]:
    """``found`` of the picture ``key`` as a packed image, gone again on an error inside; None for
    None."""
    if found is None:
        yield None
        return
    image = _load(found, key)
    try:
        yield image
    except BaseException:
        bpy.data.images.remove(image)
        raise


def replace(image: bpy.types.Image) -> None:
    """Let ``image`` be the only one.  Those before are left without users, for ``free_unused``: a
    handler that deletes data which the depsgraph still lists crashes Blender."""
    for other in [one for one in bpy.data.images if TAG in one and one != image]:
        del other[TAG]
        other[FORMER] = True
        other.name = f"{NAME} (former)"
    image.name = NAME


def free_unused() -> None:
    """Delete it where no material reflects it, and those that it has replaced."""
    ours = (one for one in bpy.data.images if TAG in one or FORMER in one)
    for image in [one for one in ours if not one.users]:
        bpy.data.images.remove(image)


def _load(found: Reflections, key: str) -> bpy.types.Image:
    image = bpy.data.images.load(str(found.path), check_existing=False)
    image.name = NAME
    image.colorspace_settings.name = "Non-Color"
    image.alpha_mode = "CHANNEL_PACKED"
    if 0 in image.size or not (image.has_data and image.is_float):
        bpy.data.images.remove(image)
        raise BakeError("Blender cannot read the reflections: bake again")
    image.pack()
    image.filepath_raw = f"//{NAME}.exr"
    peaks = [asdict(peak) for peak in found.peaks]
    image[TAG] = json.dumps({"sheet": asdict(found.sheet), "peaks": peaks, "key": key})
    return image
