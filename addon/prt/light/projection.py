"""The world's light as spherical harmonics.

The picture alone is projected, unrotated and without strength, so that a world that is turned or
recoloured needs no new projection: ``world_sh`` does both.
"""

from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path

import numpy as np
import numpy.typing as npt

from .. import sh
from ..errors import BakeError
from ..job import LIGHT_ORDER, LightSource

FACE_NAMES = ("px", "nx", "py", "ny", "pz", "nz")
PICTURES = (".exr", ".hdr")

Float = npt.NDArray[np.float64]
Pixels = npt.NDArray[np.float32]


@dataclass(frozen=True)
class Projected:
    """``image_sh`` (25, 3): coefficients of the picture, or of 1 where there is none (0 x 0).

    ``is_cubemap`` says how the picture was read, ``width`` and ``height`` how large it is (one
    face's, where six files hold the faces).  ``repairs`` counts pixels by what was wrong with
    them: negative, nan, infinite.  ``picture`` is the repaired picture itself, (H, W, 3) or the
    faces (6, N, N, 3) of a cubemap; None where there is none.
    """

    image_sh: Float
    repairs: dict[str, int] = field(default_factory=dict)
    width: int = 0
    height: int = 0
    is_cubemap: bool = False
    picture: Pixels | None = field(default=None, compare=False, repr=False)

    @cached_property
    def pixels(self) -> Pixels | None:
        """The picture as a lat-long map (H, W, 3), top row first."""
        if self.picture is None or not self.is_cubemap:
            return self.picture
        from . import cubemap

        return cubemap.to_lat_long(self.picture)


def project(source: LightSource) -> Projected:
    """The coefficients of the picture of ``source``, to order 5.

    BakeError where its file cannot be read or it has no pixels.
    """
    pixels = _pixels(source)
    if pixels is None:
        return Projected(_constant())
    from . import cubemap, lat_long

    if not pixels.size:
        raise BakeError("The world's picture has no pixels")
    repaired, repairs = repair(np.asarray(pixels, np.float32))
    height, width = repaired.shape[-3:-1]
    if repaired.ndim == 3 and source.may_be_cubemap and cubemap.is_cubemap(height, width):
        repaired = cubemap.to_faces(repaired)
    cubic = repaired.ndim == 4
    project_picture = cubemap.project if cubic else lat_long.project
    image_sh = project_picture(repaired, LIGHT_ORDER)
    return Projected(image_sh, repairs, width, height, cubic, repaired)


def _pixels(source: LightSource) -> Pixels | None:
    """(H, W, 3) of one picture, (6, N, N, 3) of a folder with six faces; None for a colour."""
    if source.pixels is not None or source.image is None:
        return source.pixels
    from ..files import images

    if source.may_be_cubemap and Path(source.image).is_dir():
        return _six_faces(Path(source.image))
    try:
        return images.read(source.image)
    except BakeError as error:
        name = repr(source.title) if source.title else source.image
        raise BakeError(str(error).replace(source.image, name)) from error


def _six_faces(folder: Path) -> Pixels:
    """The faces px, nx, py, ny, pz, nz (.exr or .hdr) of ``folder``, as (6, N, N, 3)."""
    from ..files import images

    faces = []
    for name in FACE_NAMES:
        found = [p for p in sorted(folder.iterdir()) if p.stem == name and p.suffix in PICTURES]
        if not found:
            raise BakeError(
                f"The folder {folder} has no {name}.exr or {name}.hdr: it needs six faces"
            )
        faces.append(images.read(str(found[0])))
    if len({face.shape for face in faces}) > 1 or faces[0].shape[0] != faces[0].shape[1]:
        raise BakeError(f"The six faces in {folder} are not squares of one size")
    return np.stack(faces)


def world_sh(image_sh: npt.ArrayLike, strength: npt.ArrayLike, rotation: npt.ArrayLike) -> Float:
    """Radiance coefficients (n², 3) of ``strength * image(rotation @ direction)``, world frame."""
    inverse = np.asarray(rotation, np.float64).T
    return sh.rotate(image_sh, inverse) * np.asarray(strength, np.float64)


def repair(pixels: Pixels) -> tuple[Pixels, dict[str, int]]:
    """Radiance that can be summed, and the number of pixels with each fault that was mended.

    Negative values and NaN become 0; +inf, which is a sun that went over the range of half floats,
    becomes the picture's largest finite value.  A sound picture is returned itself, not copied.
    """
    with np.errstate(invalid="ignore"):
        sound = pixels.min() >= 0 and pixels.max() < np.inf  # False for NaN
    if sound:
        return pixels, {"negative": 0, "nan": 0, "infinite": 0}
    mended = np.array(pixels, order="C")
    flat = mended.reshape(-1)
    places = np.flatnonzero(~((flat >= 0) & (flat < np.inf)))  # few, so all else is of them alone
    values = flat[places]
    faults = {"negative": values < 0, "nan": np.isnan(values), "infinite": values == np.inf}
    flat[places] = 0
    flat[places[faults["infinite"]]] = flat.max()
    channels = pixels.shape[-1]
    return mended, {name: len(np.unique(places[at] // channels)) for name, at in faults.items()}


def _constant() -> Float:
    """Coefficients (25, 3) of 1 in every direction."""
    coefficients = np.zeros((LIGHT_ORDER**2, 3))
    coefficients[0] = np.sqrt(4 * np.pi)
    return coefficients
