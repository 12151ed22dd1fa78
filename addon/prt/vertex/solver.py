"""Values at the points of a receiver, out of a number of rays a point: traced at the points
themselves, or fitted to what is found inside the triangles.

Which is better depends on the mesh and on the noise.  On a smooth surface samples inside the
triangles and a smooth fit halve the error.  Where the mesh is too coarse for its shadows, many
samples with fewer rays each find the values whose interpolation is nearest.  Where it is coarse
and the rays are few too, what is traced at the points is hard to beat, and some samples inside
do no harm.  A pilot in some triangles tells the second case, and how well a fit to the first
samples predicts others the first from the third.  The rays of both are part of the whole, and
their places are samples.  Where nothing may be fitted there is nothing to tell: all is traced at
once.
"""

from collections.abc import Callable, Generator
from dataclasses import dataclass

import numpy as np

from ..job import Receiver, Settings
from ..surface.points import Float, Index, Points
from ..surface.samples import Places, stratified_places
from ..tracing.buried import buried, fill, rays_for
from ..tracing.rays import Occlusion
from .fit_mesh import interpolated
from .parts import MIN_RAYS, Parts, joined, may_fit, parts_of
from .projection import Projection
from .traced import Array, Found, Mask, Trace, Traced, Tracer, part_of
from .values import Values, squares

POINTS, SMOOTH, BOTH, FINE = range(4)  # how a part is found
NONE = np.zeros(0, np.int64)

PILOT_SHARE = 1 / 60  # of a part's points: pilot triangles
PILOT = (12, 150)  # the fewest and the most of them
LOOKS = (128, 512)  # the fewest and the most places that tell how coarse a mesh is
REST_PILOT = (4, 64)  # where nothing is to be chosen
COARSE = 8.0  # squared error of interpolation over the noise's: above, the mesh is too coarse
SMOOTH_ERROR = 1.3  # of the points' error: below, a fit to the first samples is promising


@dataclass(frozen=True)
class Solved(Found):
    """What was found of points, with all places that rays started from; ``projection``, how more
    that is found there is shown; ``lost`` (P, n²), what of the transfer was taken for noise after
    what is exact for one world had been made of all of it."""

    projection: Projection
    lost: Array


def solve(
    receiver: Receiver,
    points: Points,
    trace: Trace,
    occlusion: Occlusion,
    settings: Settings,
    *,
    rays: int,
    noise: float | Callable[[Traced], float],
) -> Generator[int, None, Solved]:
    """Values of ``points`` out of ``rays`` a point, whose tracing has a relative error of
    ``noise``; where nothing ``may_fit``, that may be what finds it of all that was traced.  Yields
    the rays cast so far."""
    parts = parts_of(receiver, points, may_fit(receiver, settings, rays))
    tracer = Tracer(points, parts, trace, rays)
    if parts.count > 1:
        assert not callable(noise)
        plans = yield from _planned(tracer, settings, noise)
        yield from _main(tracer, plans, settings.seed + 2)
    else:
        plans = np.array([POINTS])
        yield from tracer.follow(np.arange(parts.mesh.count), _inside_some(parts, settings), rays)
        noise = noise(tracer.traced) if callable(noise) else noise
    traced = tracer.traced
    transfer = traced.values[:, : settings.order**2]
    unseen = buried(traced.origins, traced.normals, transfer, occlusion)
    work = Values(points, parts, plans != POINTS, settings, noise)
    has_points = (plans == BOTH) | (plans == FINE)
    if has_points.any():
        shown, dark = work.as_traced(traced, unseen)
        fill(points, receiver, shown, dark)
        work.keep_better(traced[~unseen], shown, has_points)
    values, lost, hidden = work.values(traced, unseen)
    filled, givers = fill(points, receiver, values, hidden)
    lost[filled] = lost[givers]
    entry = {
        "rays": tracer.cast + rays_for(transfer),
        "buried_points": int(hidden.sum()),
        **work.report(traced, unseen, values),
    }
    projection = Projection(parts, work, traced, unseen, hidden, filled, givers)
    return Solved(values, entry, traced, projection, lost)


def pilot_error(
    receiver: Receiver,
    points: Points,
    trace: Trace,
    settings: Settings,
    *,
    rays: int,
    noise: float,
) -> Generator[int, None, float]:
    """About how wrong values of ``points`` are between these, relative to all, without the noise
    of ``rays`` a place, which is ``noise``.  Yields the rays cast so far."""
    parts = parts_of(receiver, points, may_fit=False)
    tracer = Tracer(points, parts, trace, rays)
    triangles = np.arange(len(parts.mesh.corners))
    count = int(np.clip(len(points.origins) * PILOT_SHARE, *LOOKS))
    areas = parts.surface.areas
    places = stratified_places(parts.surface, triangles, areas, count, settings.seed)
    yield from tracer.follow(parts.corners_of(places), places, rays)
    squared = _coarseness(tracer, settings, noise)
    return float(noise * np.sqrt(squared[parts.rest]))


def _planned(tracer: Tracer, settings: Settings, noise: float) -> Generator[int, None, Index]:
    """How each part (count,) is to be found, after a pilot and first samples."""
    parts, rays = tracer.parts, tracer.rays
    inside = _inside_some(parts, settings)
    yield from tracer.follow(parts.corners_of(inside), inside, rays)
    ratios = _coarseness(tracer, settings, noise)
    plans = np.where((ratios >= COARSE) & (rays >= 4 * MIN_RAYS), FINE, BOTH)
    plans[parts.rest] = POINTS
    first = plans == BOTH
    if first.any():
        yield from _first(tracer, first, settings.seed + 1)
        trial = Values(tracer.points, parts, first, settings, noise)
        of_points = noise**2 * (ratios + 0.5)
        plans[_smooth(tracer, trial, first, of_points, settings)] = SMOOTH
    return plans


def _inside_some(parts: Parts, settings: Settings) -> Places:
    """A place in some triangles of each part: the pilot's."""
    places = []
    for part, (triangles, size) in enumerate(zip(parts.triangles(), parts.sizes(), strict=True)):
        if len(triangles):
            low, high = REST_PILOT if part == parts.rest else PILOT
            count = int(np.clip(size * PILOT_SHARE, low, high))
            areas = parts.surface.areas[triangles]
            places.append(stratified_places(parts.surface, triangles, areas, count, settings.seed))
    return joined(places)


def _coarseness(tracer: Tracer, settings: Settings, noise: float) -> Float:
    """What the pilot says of each part (count,): the squared error of interpolation over that of
    the noise, 0 where nothing is seen."""
    parts, traced = tracer.parts, tracer.traced
    transfer = traced.values[:, : settings.order**2]
    inside = traced.point < 0
    at_points = np.zeros((parts.mesh.count, transfer.shape[1]), np.float32)
    at_points[traced.point[~inside]] = transfer[~inside]
    places, found = traced.places[inside], transfer[inside]
    dark = ~at_points.any(axis=1)
    lit = found.any(axis=1) & ~dark[parts.mesh.corners[places.triangles]].any(axis=1)
    missed = squares(found - interpolated(parts.mesh, places, at_points))
    of_noise = noise**2 * squares(found)
    expected = of_noise * (1 + np.square(places.barycentric).sum(axis=1))
    of = parts.of_triangles[places.triangles]
    excess = np.bincount(of, np.where(lit, missed - expected, 0), parts.count)
    variance = np.bincount(of, np.where(lit, of_noise, 0), parts.count)
    return np.maximum(excess, 0) / np.where(variance > 0, variance, np.inf)


def _smooth(
    tracer: Tracer, trial: Values, first: Mask, of_points: Float, settings: Settings
) -> Mask:
    """In which parts (count,), of those with ``first`` samples, a fit to these predicts others
    nearly as well as points would: with a squared relative error of ``of_points`` (count,)."""
    traced = tracer.traced
    lit = traced.values[:, : settings.order**2].any(axis=1)
    found = traced[lit & (traced.point < 0) & first[part_of(tracer.parts, traced)]]
    errors = trial.left_out(found)
    return np.asarray(first & (errors.surface <= SMOOTH_ERROR**2 * of_points * errors.size))


def _inside(tracer: Tracer, counts: Float, seed: int) -> Places:
    """About ``counts`` (count,) places inside of each part's triangles."""
    parts, whole = tracer.parts, np.maximum(counts, 0).astype(np.int64)
    return joined(
        [
            stratified_places(parts.surface, triangles, parts.density(triangles), count, seed)
            for triangles, count in zip(parts.triangles(), whole, strict=True)
            if count
        ]
    )


def _unknown(tracer: Tracer, chosen: Mask) -> Index:
    """The points of the ``chosen`` parts (count,) that are not traced yet."""
    return np.flatnonzero(chosen[tracer.parts.of_points] & ~tracer.known())


def _first(tracer: Tracer, chosen: Mask, seed: int) -> Generator[int, None, None]:
    """Trace samples with half of a point's rays, so many that three quarters of the rays are left
    for every point."""
    unknown = tracer.parts.of_points[_unknown(tracer, chosen)]
    points = np.bincount(unknown, minlength=tracer.parts.count)
    counts = np.where(chosen, 2 * (tracer.left() - 0.75 * points), 0)
    yield from tracer.follow(NONE, _inside(tracer, counts, seed), tracer.rays // 2)


def _main(tracer: Tracer, plans: Index, seed: int) -> Generator[int, None, None]:
    """Trace what ``plans`` (count,) want with the rays that are left."""
    rays, left = tracer.rays, tracer.left()
    yield from tracer.follow(_unknown(tracer, plans == POINTS), joined([]), rays)
    smooth = _inside(tracer, np.where(plans == SMOOTH, left, 0), seed)
    yield from tracer.follow(NONE, smooth, rays)
    yield from tracer.follow(_unknown(tracer, plans == BOTH), joined([]), 3 * rays // 4)
    fine = _unknown(tracer, plans == FINE)
    points = np.bincount(tracer.parts.of_points[fine], minlength=len(plans))
    inside = _inside(tracer, np.where(plans == FINE, 4 * left - points, 0), seed)
    yield from tracer.follow(fine, inside, rays // 4)
