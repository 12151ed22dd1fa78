"""Many rows in pieces whose arrays stay in the processor's cache."""

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float32]

CACHED = 1 << 17  # floats that are found before they are summed


def slices(count: int, size: int) -> list[slice]:
    """``count`` rows, ``size`` at a time."""
    return [slice(start, min(start + size, count)) for start in range(0, count, size)]


def cached_slices(count: int, floats: int) -> list[slice]:
    """``count`` rows of so many ``floats`` each, few enough at a time."""
    return slices(count, max(1, CACHED // max(1, floats)))


def weighted_sums(values: Array, rows: npt.NDArray[np.int64], weights: Array) -> Array:
    """The sums (S, K) of the ``rows`` (S, J) of ``values`` (T, K) with ``weights`` (S, J)."""
    out = np.empty((len(rows), 1, values.shape[1]), np.float32)
    for some in cached_slices(len(rows), rows.shape[1] * values.shape[1]):
        found = values.take(rows[some], axis=0, mode="clip")
        np.matmul(weights[some, None], found, out=out[some])
    return out[:, 0]
