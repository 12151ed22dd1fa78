"""Points inside of other things: a floor's vertices under a crate.

Nothing sees them, but the triangles that cross the crate's side show a mix of them and of their
neighbours outside: a dark saw-tooth along every object that stands on something.  So the buried
points next to sound ones take their darkest neighbour's transfer instead: it grows darker towards
a contact, and a crevice (the rim of Suzanne's eyes) must not be lit by what lies around it.
"""

from typing import Any

import numpy as np
import numpy.typing as npt

from .. import sh
from ..job import Receiver
from ..surface.points import Points, element_triangles
from . import identity
from .hemisphere import frames, rays_in_world
from .rays import Occlusion

Array = npt.NDArray[np.float32]
Mask = npt.NDArray[np.bool_]
Index = npt.NDArray[np.int64]

RAYS = 16
OPEN = float(sh.open_transfer([0.0, 0.0, 1.0], 1)[0])
CRACK = 1 / 256  # of the open sky
CHUNK = 4096  # points


def buried(
    origins: Array, normals: Array, transfer: npt.NDArray[Any], occlusion: Occlusion
) -> Mask:
    """Which points (P, 3) with ``transfer`` (P, ...) see no sky but through a crack, and mostly the
    backs of triangles."""
    found = np.zeros(len(origins), bool)
    dark = np.flatnonzero(is_dark(transfer))
    in_world = rays_in_world(RAYS)
    for start in range(0, len(dark), CHUNK):
        some = dark[start : start + CHUNK]
        starts, directions = np.empty((2, len(some) * RAYS, 3), np.float32)
        in_world.origins(origins[some], starts)
        azimuth = identity.azimuths(identity.keys(origins[some], normals[some]), 0)
        local = frames(normals[some], azimuth)
        in_world.directions(local.matrices(), directions)
        backs = occlusion.meets_back(starts, directions).reshape(len(some), RAYS)
        found[some] = backs.mean(axis=1) > 0.5
    return found


def rays_for(transfer: npt.NDArray[Any]) -> int:
    """The rays that ``buried`` casts for points with ``transfer`` (P, ...)."""
    return RAYS * int(is_dark(transfer).sum())


def is_dark(transfer: npt.NDArray[Any]) -> Mask:
    """Where the mean of the sky that is seen, the first coefficient, is next to nothing."""
    rows = transfer.reshape(len(transfer), -1)
    return np.asarray(rows[:, :1].sum(axis=1) <= CRACK * OPEN)


def fill(points: Points, receiver: Receiver, transfer: Array, hidden: Mask) -> tuple[Index, Index]:
    """Give ``hidden`` points that share a triangle with sound ones the darkest one's ``transfer``
    (P, n²); which points (B,) got it from which (B,)."""
    if not hidden.any():
        return np.zeros(0, np.int64), np.zeros(0, np.int64)
    corners = points.element_points[element_triangles(receiver)]
    corners = corners[(corners >= 0).all(axis=1) & hidden[corners].any(axis=1)]
    sides = np.concatenate([corners[:, [0, 1]], corners[:, [1, 2]], corners[:, [2, 0]]])
    pairs = np.concatenate([sides, sides[:, ::-1]])
    pairs = pairs[hidden[pairs[:, 0]] & ~hidden[pairs[:, 1]]]
    darkest_first = pairs[np.lexsort((transfer[pairs[:, 1], 0], pairs[:, 0]))]
    filled, first = np.unique(darkest_first[:, 0], return_index=True)
    givers = darkest_first[first, 1]
    transfer[filled] = transfer[givers]
    return filled, givers
