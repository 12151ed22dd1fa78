"""The rays of points that their horizon makes needless."""

from dataclasses import dataclass
from math import pi
from typing import Any

import numpy as np
import numpy.typing as npt

from ..surface.points import Points
from .hemisphere import GROUP
from .horizon import Horizon
from .rising import SECTORS

Array = npt.NDArray[np.float32]
Index = npt.NDArray[np.int64]
Turns = npt.NDArray[np.uint32]

PIECE = 1024  # groups
PARTS = 4  # of a group, each with a horizon of its own
STEPS = 32  # of the rays that all points of a batch can save
PAYS = 0.2  # of a batch's rays: so many have to be saved one by one
SHIFT = np.uint32(32 - SECTORS.bit_length() + 1)


def turns(angle: npt.ArrayLike) -> Turns:
    """Angles in radians as 2^-32 of a turn, which wrap exactly."""
    share = np.asarray(angle, np.float64) / (2 * pi) % 1
    return (share * 2.0**32).astype(np.uint64).astype(np.uint32)


@dataclass(frozen=True)
class Alike:
    """Groups of points, ascending ``groups`` (G,), whose ``first`` rays, as many as that, are open,
    and whether it ``pays`` to ask for the mask of the others."""

    groups: Index
    first: int
    pays: bool


class OpenRays:
    """Which of ``rays`` directions, ordered by their angle to the normal, need no tracing from
    groups of neighbouring points: of all points of a group the first ones, and of its points' other
    rays those that ``mask`` tells, where it pays to ask.

    What the ``horizon`` says of each of the ``pieces`` of the groups is to be found first."""

    def __init__(self, horizon: Horizon | None, points: Points, rays: int) -> None:
        self._horizon, self._points, self._rays = horizon, points, rays
        groups = -(-len(points.origins) // GROUP)
        shape = (groups, 1, 1) if horizon is None else (groups, PARTS, SECTORS)
        self._limits = np.zeros(shape, np.int32)

    def pieces(self) -> list[slice]:
        """Of the groups."""
        if self._horizon is None:
            return []
        return [slice(i, i + PIECE) for i in range(0, len(self._limits), PIECE)]

    def find(self, piece: slice) -> None:
        """Ask the horizon about a piece of the groups."""
        assert self._horizon is not None
        limits = self._limits[piece]
        rows = np.arange(piece.start * GROUP, (piece.start + len(limits)) * GROUP)
        rows = np.minimum(rows, len(self._points.origins) - 1)
        origins, normals = self._points.origins[rows], self._points.normals[rows]
        origins, normals = (v.reshape(len(limits), GROUP, 3) for v in (origins, normals))
        shares = self._horizon.open_shares(origins, normals, PARTS)
        limits[:] = np.floor(np.minimum(shares + 1e-9, 1) * self._rays)

    def alike(self) -> list[Alike]:
        """All groups."""
        first = self._limits.min(axis=(1, 2)).astype(np.int64)
        first = first * STEPS // self._rays * self._rays // STEPS
        more = self._limits.mean(axis=(1, 2)) - first
        keys = 2 * first + (more > PAYS * np.maximum(self._rays - first, 1))
        order = np.argsort(keys, kind="stable")
        cuts = np.flatnonzero(np.diff(keys[order])) + 1
        apart = np.split(order, cuts) if len(order) else []
        return [Alike(groups, int(first[groups[0]]), bool(keys[groups[0]] % 2)) for groups in apart]

    def mask(
        self, numbers: Index, directions: Turns, azimuth: Turns, first: int
    ) -> npt.NDArray[Any]:
        """Which rays (P, N - first) of the points ``numbers`` (P,), turned by ``azimuth`` (P,),
        reach the sky for certain, where all ``directions`` (N,) lie at these angles."""
        sector = (directions[first:] + azimuth[:, None]) >> SHIFT
        sector += (numbers // (GROUP // PARTS) * SECTORS).astype(np.uint32)[:, None]
        limit = self._limits.reshape(-1).take(sector)
        return np.asarray(np.arange(first, len(directions), dtype=np.int32) < limit)
