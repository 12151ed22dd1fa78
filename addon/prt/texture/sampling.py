"""Reading an atlas as a GPU does."""

from typing import Any

import numpy as np
import numpy.typing as npt

Float = npt.NDArray[np.float64]
Index = npt.NDArray[np.int64]


def footprint(uvs: npt.NDArray[Any], size: int) -> tuple[Index, Float]:
    """The texels (S, 4) that a bilinear read at ``uvs`` (S, 2) mixes, as flat indices, and their
    weights (S, 4), whose sum is 1.  Past the outermost centres the outermost texels go on, as a
    texture reads that is clamped to its edge."""
    places = np.clip(np.asarray(uvs, np.float64) * size - 0.5, 0, size - 1)
    first = np.minimum(places.astype(np.int64), max(size - 2, 0))
    after = places - first
    then = np.minimum(first + 1, size - 1)
    (column, row), (right, up) = first.T, then.T
    (s, t) = after.T
    texels = np.stack([row * size + column, row * size + right, up * size + column,
                       up * size + right], axis=1)  # fmt: skip
    weights = np.stack([(1 - s) * (1 - t), s * (1 - t), (1 - s) * t, s * t], axis=1)
    return texels, weights


def bilinear(image: npt.NDArray[Any], uvs: npt.NDArray[Any]) -> npt.NDArray[Any]:
    """What a bilinear read of ``image`` (N, N, K), row 0 at the bottom, finds at ``uvs`` (S, 2):
    (S, K) in the image's own precision, of the image as it is, without mips."""
    size = len(image)
    texels, weights = footprint(uvs, size)
    flat = image.reshape(size * size, -1)
    found = np.zeros((len(texels), flat.shape[1]), image.dtype)
    for k in range(4):
        found += flat[texels[:, k]] * weights[:, k, None].astype(image.dtype)
    return found
