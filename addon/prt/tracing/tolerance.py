"""How many rays a point needs for the error that was asked for."""

from collections.abc import Generator
from dataclasses import dataclass, replace

import numpy as np

from ..job import Settings
from ..surface.points import Points
from .rays import Occlusion
from .transfer import CAST, Shortcuts, estimate_error, trace_all

FALL = 0.77  # the error falls as N^-0.77
FEWEST, MOST = 16, 65536
PILOTS = ((64, 1024), (512, 512), (4096, 256))  # rays and points
GLANCE = ((64, 256),)
MANY_BLOCKED = 0.02  # of the points: then each point's first rays are traced first
FIRST_RAYS = 4  # every fourth ray is one of the first


@dataclass(frozen=True)
class Effort:
    """``rays`` a point, the relative RMS error (``noise``) that is expected of them, whether every
    point's first rays are worth a look (``pilot``, as in Shortcuts), and the rays that finding all
    this out has cast."""

    rays: int
    noise: float = 0.0
    pilot: int = 0
    cast: int = 0


def effort(
    points: Points, occlusion: Occlusion, settings: Settings, shortcuts: Shortcuts
) -> Generator[int, None, Effort]:
    """The effort that brings the relative RMS error of the transfer at ``points`` to the tolerance,
    or the one of the fixed number of rays where there is no tolerance.

    A part of the points is traced with few rays; where the count that follows is far from there,
    once more with more of them.  Yields the rays cast so far.
    """
    done = Effort(FEWEST if settings.tolerance else settings.rays)
    if not len(points.origins):
        return done
    for pilot, places in PILOTS if settings.tolerance else GLANCE:
        if done.cast and done.rays < 1.5 * pilot:
            break
        some = _some(points, places)
        its = replace(settings, rays=pilot)
        transfer = np.empty((len(some.origins), settings.order**2), np.float32)
        few = Shortcuts(shortcuts.horizon)
        counts = yield from trace_all(some, occlusion, its, transfer, shortcuts=few)
        error, more = estimate_error(some, occlusion, its, transfer)
        rays = settings.rays
        if settings.tolerance:
            needed = pilot * (error / settings.tolerance) ** (1 / FALL)
            rays = int(np.clip(np.ceil(needed), FEWEST, MOST))
        blocked = float((~transfer.any(axis=1)).mean())
        stops = FIRST_RAYS if settings.tolerance and blocked > MANY_BLOCKED else 0
        noise = error * (pilot / rays) ** FALL
        done = Effort(rays, noise, stops, done.cast + counts[CAST] + more)
    return done


def _some(points: Points, places: int) -> Points:
    """At most ``places`` of the points, evenly chosen."""
    count = len(points.origins)
    chosen = np.unique(np.linspace(0, count - 1, min(count, places)).astype(np.int64))
    return Points(points.origins[chosen], points.normals[chosen], points.element_points[:0])
