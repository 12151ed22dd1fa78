"""What a trace shows of its rays to somebody who looks where they end."""

from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
import numpy.typing as npt

from .rays import Mask

Array = npt.NDArray[np.float32]
Index = npt.NDArray[np.int64]


@dataclass(frozen=True)
class Shown:
    """Rays to be looked at: ``rays`` (W,), at even distances, of each of the points ``numbers``
    (P,), in a row as ``origins`` and ``directions`` (P * W, 3), which are ``local`` (W, 3) in the
    points' frames.  Of their ``others`` (P, 4) how many are blocked, and the sum of these in their
    frames."""

    numbers: Index
    rays: Index
    local: Array
    origins: Array
    directions: Array
    others: Array


class Look(Protocol):
    """Looks where rays end, and not only whether they reach the sky."""

    def __call__(self, shown: Shown) -> Mask:
        """For the rays that are shown (P * W,): CLEAR or BLOCKED, as a sky mask."""
        ...


def stride(chosen: npt.NDArray[np.bool_]) -> Any:
    """The ``chosen`` columns, as a slice where they are one: numpy fills it eight times faster."""
    where = np.flatnonzero(chosen)
    steps = np.diff(where)
    if not len(steps) or (steps != steps[0]).any():
        return chosen
    return slice(int(where[0]), int(where[-1]) + 1, int(steps[0]))
