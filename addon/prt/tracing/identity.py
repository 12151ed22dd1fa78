"""A number for every place, from its bits alone: the same in whatever order places come."""

from math import pi
from typing import Any

import numpy as np
import numpy.typing as npt

Keys = npt.NDArray[np.uint64]

MIXERS = 0xBF58476D1CE4E5B9, 0x94D049BB133111EB  # splitmix64's


def keys(*rows: npt.NDArray[np.float32]) -> Keys:
    """64 bits (M,) for what arrays (M, 3) say together of each of M places."""
    mixed = np.zeros(len(rows[0]), np.uint64)
    for array in rows:
        bits = np.ascontiguousarray(array, np.float32).view(np.uint32)
        for column in bits.T:
            mixed = _mix(mixed ^ column)
    return mixed


def azimuths(of: Keys, seed: int) -> npt.NDArray[np.float64]:
    """Angles (M,), in radians, of no pattern for the places with keys ``of``."""
    mixed = _mix(of ^ np.uint64(seed + 1))
    return np.asarray((mixed >> np.uint64(11)) * (2 * pi / 2.0**53), np.float64)


def _mix(values: npt.NDArray[Any]) -> Keys:
    """splitmix64's last steps, Steele, Lea and Flood 2014, over a sum that lets no bit be zero."""
    mixed = np.asarray(values + np.uint64(0x9E3779B97F4A7C15), np.uint64)
    mixed = (mixed ^ (mixed >> np.uint64(30))) * np.uint64(MIXERS[0])
    mixed = (mixed ^ (mixed >> np.uint64(27))) * np.uint64(MIXERS[1])
    return np.asarray(mixed ^ (mixed >> np.uint64(31)), np.uint64)
