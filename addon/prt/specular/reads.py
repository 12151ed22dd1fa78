"""Reads between texels: linear, from the four nearest.

In EEVEE these are four reads with *Closest*.  Its own *Linear* takes a mip level, which goes wrong
wherever the place jumps from one pixel to the next, as at the wrap; so does *Cubic* on a computer
without a graphics card.
"""

import numpy as np
import numpy.typing as npt

Float = npt.NDArray[np.float64]


def bilinear(image: npt.ArrayLike, x: npt.ArrayLike, y: npt.ArrayLike) -> Float:
    """Between the centres, which are at halves, of the texels of ``image`` (H, W, K), at ``x`` and
    ``y`` (P,) in texels: (P, K).  Only texels inside may be touched."""
    values = np.asarray(image)
    across, down = np.asarray(x, np.float64) - 0.5, np.asarray(y, np.float64) - 0.5
    column, row = np.floor(across).astype(np.int64), np.floor(down).astype(np.int64)
    right, below = (across - column)[:, None], (down - row)[:, None]
    first = values[row, column] * (1 - right) + values[row, column + 1] * right
    second = values[row + 1, column] * (1 - right) + values[row + 1, column + 1] * right
    return np.asarray(first * (1 - below) + second * below)


def response(frequency: Float) -> Float:
    """What reads make of ``cos(frequency i)``: 1 at the texels' centres and less between, and this
    is half way.  Divided by it, a smooth image is read as much too high as too low."""
    return np.asarray(0.5 + 0.5 * np.cos(0.5 * frequency))
