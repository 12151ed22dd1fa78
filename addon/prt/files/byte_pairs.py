"""Numbers of 16 bits in pictures of 8: browsers read a PNG of 16 bits as one of 8.

A picture holds three columns of an image as red, green and blue, the high bytes of N rows above
their low bytes.  It has no alpha and names no colour space, so whatever decodes it keeps its bytes.
``value = offset + scale * (256 * high + low) / 65535``.
"""

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from .png import MOST

Array = npt.NDArray[np.float32]
Bytes = npt.NDArray[np.uint8]
Numbers = npt.NDArray[np.float64]
COLUMNS = 3  # a picture


def count(columns: int) -> int:
    """How many pictures hold so many columns."""
    return -(-columns // COLUMNS)


def ranges(image: Array) -> tuple[Numbers, Numbers]:
    """Offset and scale (K,) of the columns of ``image`` (N, N, K): their least value, and how far
    it is to the greatest.  Every value is off by at most ``scale / 131070``."""
    flat = image.reshape(-1, image.shape[2])
    low, high = flat.min(axis=0).astype(float), flat.max(axis=0).astype(float)
    return low, high - low


def split(image: Array, offset: Numbers, scale: Numbers) -> Iterator[Bytes]:
    """The pictures (2 N, N, 3) of ``image`` (N, N, K), both with the top row first."""
    size, _, columns = image.shape
    for first in range(0, columns, COLUMNS):
        picture = np.zeros((2, size, size, COLUMNS), np.uint8)
        for c in range(first, min(first + COLUMNS, columns)):
            shares = (image[:, :, c] - offset[c]) / (scale[c] or 1.0)
            steps = np.rint(MOST * np.clip(shares, 0, 1)).astype(np.uint16)
            picture[0, :, :, c - first], picture[1, :, :, c - first] = steps >> 8, steps & 255
        yield picture.reshape(2 * size, size, COLUMNS)


def joined(pictures: Sequence[npt.NDArray[Any]], offset: Numbers, scale: Numbers) -> Array:
    """The image (N, N, K) of its ``pictures`` (2 N, N, 3) of whole numbers up to 255."""
    size, columns = pictures[0].shape[1], len(offset)
    image = np.empty((size, size, columns), np.float32)
    for c in range(columns):
        channel = pictures[c // COLUMNS][:, :, c % COLUMNS].astype(np.float64)
        image[:, :, c] = offset[c] + scale[c] * (256 * channel[:size] + channel[size:]) / MOST
    return image
