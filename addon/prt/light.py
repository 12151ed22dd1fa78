"""The world's light as spherical harmonics.

The picture alone is projected, unrotated and without strength, so that a world that is turned or
recoloured needs no new projection: ``world_sh`` does both.
"""

from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

from . import cubemap, images, lat_long, sh
from .errors import BakeError
from .job import LIGHT_ORDER, LightSource

Float = npt.NDArray[np.float64]
Pixels = npt.NDArray[np.float32]


@dataclass(frozen=True)
class Projected:
    """``image_sh`` (25, 3): coefficients of the picture, or of 1 where there is none (0 x 0).

    ``repairs`` counts pixels by what was wrong with them: negative, nan, infinite.
    """

    image_sh: Float
    repairs: dict[str, int] = field(default_factory=dict)
    width: int = 0
    height: int = 0


def project(source: LightSource) -> Projected:
    """The coefficients of the picture of ``source``, to order 5.

    BakeError where its file cannot be read or it has no pixels.
    """
    pixels = source.pixels
    if pixels is None and source.image is not None:
        pixels = images.read(source.image)
    if pixels is None:
        return Projected(_constant())
    if not pixels.size:
        raise BakeError("The world's picture has no pixels")
    repaired, repairs = repair(np.asarray(pixels, np.float32))
    height, width = repaired.shape[:2]
    return Projected(project_picture(repaired, LIGHT_ORDER), repairs, width, height)


def project_picture(pixels: Pixels, order: int) -> Float:
    """Coefficients (n², 3) of a picture (H, W, 3): a cubemap where its shape is one's (4:3, 3:4,
    6:1, 1:6), else lat-long whatever its shape."""
    if cubemap.is_cubemap(*pixels.shape[:2]):
        return cubemap.project(cubemap.to_faces(pixels), order)
    return lat_long.project(pixels, order)


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
