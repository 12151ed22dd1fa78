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

PIECES = 8  # of the groups, so that some are looked at while others are traced, but
PIECE_GROUPS = 1024, 8192  # in a piece no fewer and no more
PARTS = 4  # of a group, each with a horizon of its own
STEPS = 16  # of the rays that all points of a batch can save
PAYS = 0.05  # of a batch's rays: so many have to be saved one by one
SHIFT = np.uint32(32 - SECTORS.bit_length() + 1)


def turns(angle: npt.ArrayLike) -> Turns:
    """Angles in radians as 2^-32 of a turn, which wrap exactly."""
    return (np.asarray(angle, np.float64) * (2.0**32 / (2 * pi))).astype(np.int64).astype(np.uint32)


@dataclass(frozen=True)
class Alike:
    """Groups of points, ascending ``groups`` (G,), whose ``first`` rays, as many as that, are open,
    and whether it ``pays`` to ask which of the others ``may_be_blocked``."""

    groups: Index
    first: int
    pays: bool


class OpenRays:
    """Which of ``rays`` directions, ordered by their angle to the normal, need no tracing from
    groups of neighbouring points: of all points of a group the first ones, and of its points' other
    rays all but those that ``may_be_blocked``, where it pays to ask.

    What the ``horizon`` says of each of the ``pieces`` of the groups is to be found first."""

    def __init__(self, horizon: Horizon | None, points: Points, rays: int) -> None:
        self._horizon, self._points, self._rays = horizon, points, rays
        groups = -(-len(points.origins) // GROUP)
        shape = (groups, 1, 1) if horizon is None else (groups, PARTS, SECTORS)
        self._limits = np.zeros(shape, np.min_scalar_type(rays))

    def pieces(self) -> list[slice]:
        """Of the groups."""
        groups = len(self._limits)
        size = groups if self._horizon is None else int(np.clip(groups // PIECES, *PIECE_GROUPS))
        return [slice(i, min(i + size, groups)) for i in range(0, groups, max(1, size))]

    def find(self, piece: slice) -> list[Alike]:
        """Ask the horizon about a piece of the groups; these, apart."""
        limits = self._limits[piece]
        if self._horizon is not None:
            its = (
                self._by_group(self._points.origins, piece),
                self._by_group(self._points.normals, piece),
            )
            shares = self._horizon.open_shares(*its, PARTS)
            limits[:] = np.minimum(shares + 1e-9, 1) * self._rays
        first = limits.min(axis=(1, 2)).astype(np.int64)
        first = first * STEPS // self._rays * self._rays // STEPS
        more = limits.mean(axis=(1, 2)) - first
        keys = 2 * first + (more > PAYS * np.maximum(self._rays - first, 1))
        order = np.argsort(keys, kind="stable")
        cuts = np.flatnonzero(np.diff(keys[order])) + 1
        apart = np.split(order, cuts) if len(order) else []
        return [Alike(piece.start + g, int(first[g[0]]), bool(keys[g[0]] % 2)) for g in apart]

    def _by_group(self, values: Array, piece: slice) -> Array:
        """The rows of ``values`` (P, 3) of a piece (G, GROUP, 3)."""
        its = values[piece.start * GROUP : piece.stop * GROUP]
        lacking = (piece.stop - piece.start) * GROUP - len(its)  # the last group may not be full
        return np.pad(its, ((0, lacking), (0, 0)), "edge").reshape(-1, GROUP, 3)

    def may_be_blocked(
        self, numbers: Index, directions: Turns, azimuth: Turns, first: int
    ) -> npt.NDArray[Any]:
        """Which rays (P, N - first) of the points ``numbers`` (P,), turned by ``azimuth`` (P,), may
        not reach the sky, where all ``directions`` (N,) lie at these angles."""
        sector = (directions[first:] + azimuth[:, None]) >> SHIFT
        sector += (numbers // (GROUP // PARTS) * SECTORS).astype(np.uint32)[:, None]
        limit = self._limits.reshape(-1).take(sector)
        return np.asarray(limit <= np.arange(first, len(directions), dtype=limit.dtype))
