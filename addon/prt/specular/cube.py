"""Cube maps of filtered radiance, as EXT_lights_image_based wants them.

Mip k of n is half as wide as the one before and holds the radiance of the roughness k / (n - 1).
Faces come in the order +x, -x, +y, -y, +z, -z and stand as OpenGL's, whose first row is the lowest
of the picture: so a stored face is upside down.
"""

import numpy as np
import numpy.typing as npt

from . import sheet
from .sheet import Sheet

Array = npt.NDArray[np.float32]
Float = npt.NDArray[np.float64]

FACES = 6
LARGEST = 256  # texels along a side of the first mip, for pictures of four times as many
SMALLEST = 16  # of the last one, which is smooth
FINER = 2  # reads along each side of a texel of the first


def size_of(layout: Sheet) -> int:
    """Texels along a side of the first mip that hold what ``layout`` does."""
    if layout.cell == sheet.PLAIN:
        return SMALLEST
    return min(LARGEST, layout.detail * layout.cell[0] // 4)


def mips(layout: Sheet, image: npt.ArrayLike, to_picture: npt.ArrayLike) -> list[Array]:
    """The mips (6, s, s, 3) of the radiance in ``image``, as ``layout`` arranges it; ``to_picture``
    (3, 3) takes directions of the cube to the picture's."""
    size = size_of(layout)
    count = (size // SMALLEST).bit_length()
    turn = np.asarray(to_picture, np.float64)
    return [
        _mip(layout, image, turn, size >> k, k / max(1, count - 1), FINER if k == 0 else 1)
        for k in range(count)
    ]


def directions(face: int, size: int) -> Float:
    """Unit vectors (size, size, 3) to the texels of a stored ``face``."""
    along = (np.arange(size) + 0.5) / size * 2 - 1
    right, up = np.meshgrid(along, along)
    out = np.ones_like(right)
    towards = [
        (out, up, -right),
        (-out, up, right),
        (right, out, -up),
        (right, -out, up),
        (right, up, out),
        (-right, up, -out),
    ][face]
    found = np.stack(towards, axis=2)
    return np.asarray(found / np.linalg.norm(found, axis=2, keepdims=True))


def _mip(  # noqa: PLR0917 - all of one read
    layout: Sheet, image: npt.ArrayLike, turn: Float, size: int, roughness: float, finer: int
) -> Array:
    result = np.empty((FACES, size, size, 3), np.float32)
    for face in range(FACES):
        towards = directions(face, finer * size) @ turn.T
        total = np.zeros((size * size, 3))
        for part in np.ndindex(finer, finer):
            some = towards[part[0] :: finer, part[1] :: finer].reshape(-1, 3)
            total += sheet.radiance(layout, image, some, roughness)
        result[face] = (total / finer**2).reshape(size, size, 3)
    return result
