"""How many rays a point needs for the error that was asked for."""

from collections.abc import Generator
from dataclasses import dataclass, replace
from math import sqrt

import numpy as np
import numpy.typing as npt

from ..job import Settings
from ..surface.points import Points
from .rays import Occlusion
from .transfer import CAST, Array, Shortcuts, relative_rms, trace_all

FALL = 0.77  # the error falls as N^-0.77
FEWEST, MOST = 16, 65536
AIM = 0.95  # of the tolerance, which is then kept more often than not
PILOT_RAYS = 64
ESTIMATE_POINTS = 1024  # tell an error
SURE_POINTS = 2048  # tell it surely
ERROR_OF_DIFFERENCE = 0.34  # of |T(N) - T(N/4)|, pooled: T(N) errs by 0.87 to 1.09 of that
PILOT_SHARE, PILOT_POINTS = 1 / 8, (1024, 4096)  # of the points; the fewest and the most of them
GLANCE = 256  # points, where the rays are given
SECOND_RAYS, SECOND_COST = 4096, 1 << 19  # the most rays of a point, and of all points together
NEAR = 1.5  # times the pilot's rays: what is nearer needs no second pilot
STEEPNESS = (0.5, 1.5)  # how the error may fall
DOUBT_OF_FALL, DOUBT_OF_SHARE = 0.06, 0.05  # standard errors
MANY_BLOCKED = 0.02  # of the points: then each point's first rays are traced first
FIRST_RAYS = 4  # every fourth ray is one of the first
FEWEST_FIRST = 32  # of them tell that a point sees next to nothing


@dataclass(frozen=True)
class Effort:
    """``rays`` a point, the relative RMS error (``noise``) that is expected of them, whether every
    point's first rays are worth a look (``pilot``, as in Shortcuts), and the rays that finding all
    this out has cast."""

    rays: int
    noise: float = 0.0
    pilot: int = 0
    cast: int = 0


class _Pilot:
    """Some points, traced as the bake will trace them; ``cast`` so far."""

    def __init__(self, occlusion: Occlusion, settings: Settings, shortcuts: Shortcuts) -> None:
        self._occlusion, self._settings, self.cast = occlusion, settings, 0
        self._shortcuts = Shortcuts(shortcuts.horizon)

    def transfer(self, points: Points, rays: int, turn: int = 0) -> Generator[int, None, Array]:
        """Transfer (P, n²) with ``rays`` a point, of other azimuths for another ``turn``."""
        its = replace(self._settings, rays=rays, seed=self._settings.seed + turn)
        found = np.empty((len(points.origins), its.order**2), np.float32)
        counts = yield from trace_all(
            points, self._occlusion, its, found, shortcuts=self._shortcuts
        )
        self.cast += counts[CAST]
        return found

    def error(self, points: Points, found: Array, rays: int) -> float:
        """The relative RMS error of ``found`` at ``points``, by fewer rays of other azimuths."""
        its = replace(self._settings, rays=rays)
        error, more = estimate_error(points, self._occlusion, its, found)
        self.cast += more
        return error

    def sure_error(self, points: Points, found: Array, rays: int) -> Generator[int, None, float]:
        """As ``error``, by as many rays of other azimuths, however errors fall with the rays."""
        rows = _spread(len(found), SURE_POINTS)
        again = yield from self.transfer(_at(points, rows), rays, turn=1)
        return _error_of_two(again, found[rows])


def _error_of_two(first: Array, second: Array) -> float:
    """The relative RMS error of two that err alike (P, n²): of their difference's mean square
    either has half."""
    return relative_rms(first, second) / sqrt(2)


def effort(
    points: Points, occlusion: Occlusion, settings: Settings, shortcuts: Shortcuts
) -> Generator[int, None, Effort]:
    """The effort that brings the relative RMS error of the transfer at ``points`` to the tolerance,
    or the one of the fixed number of rays where there is no tolerance.

    A part of the points is traced with few rays.  Where the count that follows is far from there,
    some of these are traced near it, and what that does to their error is taken to be what it does
    to that of all.  Yields the rays cast so far.
    """
    if not len(points.origins):
        return Effort(FEWEST if settings.tolerance else settings.rays)
    count = len(points.origins)
    if not settings.tolerance:  # a glance, at points too far apart to share a horizon
        pilot = _Pilot(occlusion, settings, Shortcuts())
        twice = _at(points, np.repeat(_spread(count, GLANCE), 2))
        found = yield from pilot.transfer(twice, PILOT_RAYS)
        noise = _error_of_two(found[::2], found[1::2]) * (PILOT_RAYS / settings.rays) ** FALL
        return Effort(settings.rays, noise, 0, pilot.cast)
    pilot = _Pilot(occlusion, settings, shortcuts)
    some = _at(points, _spread(count, int(np.clip(count * PILOT_SHARE, *PILOT_POINTS))))
    found = yield from pilot.transfer(some, PILOT_RAYS)
    error = yield from pilot.sure_error(some, found, PILOT_RAYS)
    aim = AIM * settings.tolerance
    needed = yield from _needed(pilot, some, found, error, aim)
    rays = int(np.clip(np.ceil(needed), FEWEST, MOST))
    blocked = float((~found.any(axis=1)).mean())
    stops = blocked > MANY_BLOCKED and rays >= FIRST_RAYS * FEWEST_FIRST
    noise = aim * (needed / rays) ** FALL
    return Effort(rays, noise, FIRST_RAYS if stops else 0, pilot.cast)


def _needed(
    pilot: _Pilot, points: Points, found: Array, error: float, tolerance: float
) -> Generator[int, None, float]:
    """How many rays the ``tolerance`` takes, where PILOT_RAYS have ``found`` (P, n²) the transfer
    of ``points`` with this ``error``."""
    needed = float(PILOT_RAYS * (error / tolerance) ** (1 / FALL))
    if error == 0 or PILOT_RAYS / NEAR < needed < PILOT_RAYS * NEAR:
        return needed
    if needed > PILOT_RAYS:
        rays = int(min(0.75 * needed, SECOND_RAYS))
        rows = _spread(len(found), SECOND_COST // rays)
        few = _at(points, rows)
        before = pilot.error(few, found[rows], PILOT_RAYS)
        after = pilot.error(few, (yield from pilot.transfer(few, rays)), rays)
        share = after / max(before, 1e-30)
        fall = _fall(share, rays / PILOT_RAYS)
        return float(rays * (share * error / tolerance) ** (1 / fall))
    rays = int(max(needed, FEWEST))
    fewer = yield from pilot.transfer(points, rays)
    missed = relative_rms(fewer, found)
    missed = float(np.sqrt(max(missed**2 - error**2, 0.1 * missed**2)))
    fall = np.log(max(missed / error, 1.0)) / np.log(PILOT_RAYS / rays)
    return float(rays * (missed / tolerance) ** (1 / np.clip(fall, *STEEPNESS)))


def _fall(share: float, times: float) -> float:
    """How the error falls, that ``times`` the rays leave this ``share`` of: what is usual and what
    is seen, each by how sure it is."""
    lever = float(np.log(times))
    seen = -float(np.log(max(share, 1e-6))) / lever
    sure, usual = (lever / DOUBT_OF_SHARE) ** 2, DOUBT_OF_FALL**-2
    return float(np.clip((sure * seen + usual * FALL) / (sure + usual), *STEEPNESS))


def _spread(count: int, places: int) -> npt.NDArray[np.int64]:
    return np.linspace(0, count - 1, min(count, places)).astype(np.int64)


def _at(points: Points, rows: npt.NDArray[np.int64]) -> Points:
    return Points(points.origins[rows], points.normals[rows], points.element_points[:0])


def estimate_error(
    points: Points,
    occlusion: Occlusion,
    settings: Settings,
    transfer: Array,
    rows: npt.NDArray[np.int64] | None = None,
) -> tuple[float, int]:
    """The relative RMS error of ``transfer`` (P, n²), or of these ``rows`` (M,) of it, and the rays
    that finding it took.

    A part of the points is traced again with a quarter of the rays and other azimuths; the pooled
    difference times a constant is the error of the full set.
    """
    few = replace(settings, rays=max(1, settings.rays // 4), seed=settings.seed + 1)
    rows = np.arange(len(points.origins)) if rows is None else rows
    chosen = rows[_spread(len(rows), ESTIMATE_POINTS)]
    pilot_points = _at(points, chosen)
    pilot = np.empty((len(chosen), settings.order**2), np.float32)
    *_, cast = trace_all(pilot_points, occlusion, few, pilot)
    return ERROR_OF_DIFFERENCE * relative_rms(pilot, transfer[chosen]), cast
