"""A number for every place, from its bits alone: the same in whatever order places come."""

from math import pi

import numpy as np
import numpy.typing as npt

from ..mixing import mixed

Keys = npt.NDArray[np.uint64]


def keys(*rows: npt.NDArray[np.float32]) -> Keys:
    """64 bits (M,) for what arrays (M, 3) say together of each of M places."""
    bits = (np.ascontiguousarray(array, np.float32).view(np.uint32) for array in rows)
    return mixed(column for array in bits for column in array.T)


def azimuths(of: Keys, seed: int) -> npt.NDArray[np.float64]:
    """Angles (M,), in radians, of no pattern for the places with keys ``of``."""
    drawn = mixed([of ^ np.uint64(seed + 1)])
    return np.asarray((drawn >> np.uint64(11)) * (2 * pi / 2.0**53), np.float64)
