"""What else is found out about points from the rays of their transfer."""

from collections import Counter
from dataclasses import dataclass
from typing import Protocol

import numpy as np
import numpy.typing as npt

from .rays import Occlusion

Array = npt.NDArray[np.float32]
Index = npt.NDArray[np.int64]


@dataclass(frozen=True)
class Batch:
    """Rays of P points, as a ``Gather`` reads them: the points' ``numbers`` (P,), ``origins`` and
    ``normals`` (P, 3), the world ``directions`` (P, 3, N) of their rays, whose cosines to the
    normal are the same for all, (N,), and which reach the sky, ``visible`` (P, N), 1 or 0.
    Directions with a cosine above ``open_above`` reach the sky, traced or not.  A clear ray of the
    points ``doubtful`` (P,) is to be confirmed."""

    numbers: Index
    origins: Array
    normals: Array
    directions: Array
    cosines: Array
    visible: Array
    open_above: float
    doubtful: npt.NDArray[np.bool_]


class Gather(Protocol):
    """Something else to be found out about every point, from its rays and from more of them."""

    @property
    def columns(self) -> int:
        """How many numbers it finds."""
        ...

    def __call__(self, batch: Batch, occlusion: Occlusion) -> tuple[Array, Counter[str]]:
        """Its values (P, columns) and the rays that they took."""
        ...
