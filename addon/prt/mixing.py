"""Many numbers mixed into one: equal ones for equal numbers, and for others but one in 2^64."""

from collections.abc import Iterable
from typing import Any

import numpy as np
import numpy.typing as npt

Mixed = npt.NDArray[np.uint64]

MIXERS = np.array([0xBF58476D1CE4E5B9, 0x94D049BB133111EB], np.uint64)
STEP = np.uint64(0x9E3779B97F4A7C15)  # so that not even zeros stay what they are


def mixed(columns: Iterable[npt.NDArray[Any]]) -> Mixed:
    """One number (N,) for each place of ``columns``, unsigned (N,) each and at least one, by the
    steps of splitmix64 (Steele, Lea and Flood 2014): any bit of them changes all of its bits."""
    found: Any = np.uint64(0)
    for column in columns:
        found = (np.asarray(column, np.uint64) ^ found) + STEP
        found = (found ^ (found >> np.uint64(30))) * MIXERS[0]
        found = (found ^ (found >> np.uint64(27))) * MIXERS[1]
        found ^= found >> np.uint64(31)
    return np.asarray(found, np.uint64)
