"""Radiance in pictures of 8 bits, as Babylon.js packs it: ``value = rgb ** 2.2 / alpha``, all from
0 to 1, so values reach from 0 to 255.
"""

import numpy as np
import numpy.typing as npt

GAMMA = 2.2
MOST = 255


def encoded(values: npt.ArrayLike) -> npt.NDArray[np.uint8]:
    """``values`` (..., 3) as (..., 4); what is beyond 255 becomes that, in its own hue."""
    linear = np.maximum(np.asarray(values, np.float64), 0)
    most = np.maximum(linear.max(axis=-1, keepdims=True), 1)
    alpha = np.clip(np.floor(MOST / most), 1, MOST)
    shares = linear * (alpha / MOST) / np.maximum(most / MOST, 1)
    colour = np.rint(MOST * shares ** (1 / GAMMA))
    return np.concatenate([colour, alpha], axis=-1).astype(np.uint8)
