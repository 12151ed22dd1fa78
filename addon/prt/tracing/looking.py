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


class Split:
    """How the rays ``local`` (N, 3) of a point, but the ``first`` ones, are split into those that
    are ``chosen`` (N,) to be looked at, ``rays`` (W,) along ``local`` (W, 3), and the others.
    ``mine`` and ``others`` pick their columns, of which ``mine_before`` and ``others_before`` are
    among the first; ``ones_and_local`` (N - first - W, 4) is what is summed of the others."""

    def __init__(self, chosen: npt.NDArray[np.bool_], local: Array, first: int) -> None:
        its = chosen[first:]
        self.mine, self.others = stride(its), stride(~its)
        self.mine_before = int(chosen[:first].sum())
        self.others_before = first - self.mine_before
        self.rays = first + np.flatnonzero(its)
        self.local = local[self.rays]
        self.ones_and_local = np.insert(local[first:][~its], 0, 1, axis=1)


def stride(chosen: npt.NDArray[np.bool_]) -> Any:
    """The ``chosen`` columns, as a slice where they are one: numpy fills it eight times faster."""
    where = np.flatnonzero(chosen)
    steps = np.diff(where)
    if not len(steps) or (steps != steps[0]).any():
        return chosen
    return slice(int(where[0]), int(where[-1]) + 1, int(steps[0]))
