"""Atlases on disk: all columns of an atlas as tiles of one RGBA EXR, see ``..tiles``.

The header's attribute ``prtColumns`` names the columns, separated by blanks.
"""

import math
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
import numpy.typing as npt

from ..tiles import tile_grid
from .images import read_rgba, write_rgba

Array = npt.NDArray[np.float32]
COLUMNS = "prtColumns"


def write_tiles(
    path: Path, image: Array, names: Sequence[str], *, half: bool, metadata: Mapping[str, str]
) -> None:
    """Write ``image`` (N, N, K), row 0 at the bottom, whose K columns are called ``names``, and
    ``metadata``.  OSError where there is no room."""
    size, count = len(image), len(names)
    columns, rows = tile_grid(math.ceil(count / 4))
    pixels = np.zeros((rows * size, columns * size, 4), np.float32)
    for k in range(math.ceil(count / 4)):
        some = image[::-1, :, 4 * k : 4 * k + 4]
        row, column = (k // columns) * size, (k % columns) * size
        pixels[row : row + size, column : column + size, : some.shape[2]] = some
    write_rgba(str(path), pixels, half=half, metadata={**metadata, COLUMNS: " ".join(names)})


def read_tiles(path: Path) -> tuple[Array, tuple[str, ...]]:
    """The image (N, N, K), row 0 at the bottom, that ``write_tiles`` wrote, and the names of its
    columns."""
    pixels, texts = read_rgba(str(path))
    names = tuple(texts.get(COLUMNS, "").split())
    columns, _ = tile_grid(math.ceil(len(names) / 4))
    size = pixels.shape[1] // columns
    image = np.empty((size, size, len(names)), np.float32)
    for k in range(math.ceil(len(names) / 4)):
        row, column = (k // columns) * size, (k % columns) * size
        here = image[:, :, 4 * k : 4 * k + 4]
        here[:] = pixels[row : row + size, column : column + size, : here.shape[2]][::-1]
    return image, names
