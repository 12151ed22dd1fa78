"""The rays of a part of the points that its horizon makes needless."""

from math import pi
from typing import Any

import numpy as np
import numpy.typing as npt

from ..surface.points import Points
from .hemisphere import GROUP
from .horizon import SECTORS, Horizon

Array = npt.NDArray[np.float32]
Index = npt.NDArray[np.int64]
Turns = npt.NDArray[np.uint32]

STEPS = 32  # of the rays that all points of a batch can save
PAYS = 0.2  # of a batch's rays: so many have to be saved one by one
SHIFT = np.uint32(32 - SECTORS.bit_length() + 1)


def turns(angle: npt.ArrayLike) -> Turns:
    """Angles in radians as 2^-32 of a turn, which wrap exactly."""
    share = np.asarray(angle, np.float64) / (2 * pi) % 1
    return (share * 2.0**32).astype(np.uint64).astype(np.uint32)


class OpenRays:
    """Which of ``rays`` directions, ordered by their angle to the normal, need no tracing in the
    groups of a part of the points: the first ``firsts`` (G,) of all points of a group, and of its
    points' other rays those that ``mask`` tells, where it pays to ask."""

    def __init__(self, horizon: Horizon | None, points: Points, part: slice, rays: int) -> None:
        groups = -(-(part.stop - part.start) // GROUP)
        self._limits = np.zeros((groups, 1), np.int32)
        if horizon is not None:
            rows = np.minimum(part.start + np.arange(groups * GROUP), part.stop - 1)
            origins, normals = points.origins[rows], points.normals[rows]
            origins, normals = (v.reshape(groups, GROUP, 3) for v in (origins, normals))
            shares = horizon.open_shares(origins, normals)
            self._limits = np.floor(np.minimum(shares + 1e-9, 1) * rays).astype(np.int32)
        least = self._limits.min(axis=1).astype(np.int64)
        self.firsts: Index = least * STEPS // rays * rays // STEPS
        more = self._limits.mean(axis=1) - self.firsts
        self._pays = more > PAYS * np.maximum(rays - self.firsts, 1)

    def pays(self, group: int) -> bool:
        """Whether to ask for the ``mask`` of this group."""
        return bool(self._pays[group])

    def keys(self) -> Index:
        """Equal for groups that a batch may hold together (G,)."""
        return 2 * self.firsts + self._pays

    def mask(self, rows: Index, directions: Turns, azimuth: Turns, first: int) -> npt.NDArray[Any]:
        """Which rays (P, N - first) reach the sky for certain, of points that are ``rows`` (P,) of
        the part, turned by ``azimuth`` (P,), whose ``directions`` (N,) lie at these angles."""
        sector = (directions[first:] + azimuth[:, None]) >> SHIFT
        sector += (rows // GROUP * SECTORS).astype(np.uint32)[:, None]
        limit = self._limits.reshape(-1).take(sector)
        return np.asarray(np.arange(first, len(directions), dtype=np.int32) < limit)
