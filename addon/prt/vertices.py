"""Values at the points of a receiver, out of a number of rays a point: traced at the points
themselves, or fitted to what is found inside the triangles.

Which is better depends on the mesh and on the noise.  Where noise prevails, samples inside the
triangles with all their rays and a smooth fit halve the error.  Where the mesh is too coarse for
its shadows, many samples with fewer rays each, some of them at the points, find the values whose
interpolation is nearest.  A pilot in some triangles tells the two apart; hardly any of it is
wasted, because its rays count as part of the whole and its places as samples.
"""

from collections.abc import Generator
from dataclasses import dataclass
from functools import reduce
from typing import Any, Protocol

import numpy as np
import numpy.typing as npt

from . import sh
from .buried import buried, fill, rays_for
from .fit import Fit, Samples
from .fit_mesh import interpolated
from .job import Receiver, Settings
from .parts import Parts, buried_points, joined, parts_of
from .points import Float, Index, Points, morton_order
from .rays import Occlusion
from .samples import Places, starts, stratified_places

Array = npt.NDArray[np.float32]
Mask = npt.NDArray[np.bool_]

MIN_RAYS = 32  # of a sample
PILOT_SHARE = 1 / 60  # of a part's points: pilot triangles
PILOT = (12, 150)  # the fewest and the most of them
REST_PILOT = (4, 64)  # where nothing is to be chosen
FALL = 0.77  # a Fibonacci set's error is as its rays to the minus this


class Trace(Protocol):
    """Traces origins (M, 3) with unit normals (M, 3), ``rays`` a place."""

    def __call__(self, origins: Array, normals: Array, rays: int) -> Generator[int, None, Array]:
        """Yields the rays cast so far; the value is what was found, (M, K) float32."""
        ...


@dataclass(frozen=True)
class Traced:
    """M places that rays started from: their ``origins`` and ``normals`` (M, 3), the ``values``
    (M, K) found there; the ``point`` (M,) that each is, -1 inside of a triangle; their ``places``
    on the mesh; and the rays of a point over theirs, ``split`` (M,)."""

    origins: Array
    normals: Array
    values: Array
    point: Index
    places: Places
    split: Index

    def __getitem__(self, chosen: Mask) -> "Traced":
        return Traced(*(values[chosen] for values in vars(self).values()))

    def and_(self, other: "Traced") -> "Traced":
        """Both."""
        arrays = {
            name: np.concatenate([values, getattr(other, name)])
            for name, values in vars(self).items()
            if name != "places"
        }
        return Traced(places=joined([self.places, other.places]), **arrays)


@dataclass(frozen=True)
class Solved:
    """``values`` (P, K) of the points; ``entry``, what the report says about them; ``traced``, all
    places that rays started from."""

    values: Array
    entry: dict[str, Any]
    traced: Traced


@dataclass(frozen=True)
class Plan:
    """How a part is found: by places with the rays of a point over ``split``; at the points,
    inside of the triangles, or both."""

    split: int
    at_points: bool
    inside: bool


POINTS = Plan(1, at_points=True, inside=False)
SMOOTH = Plan(1, at_points=False, inside=True)
COARSE = Plan(2, at_points=False, inside=True)
FINE = Plan(4, at_points=True, inside=True)


def choose(ratio: float, rays: int) -> Plan:
    """The plan for a part whose squared error of interpolation is ``ratio`` times that of the
    noise at ``rays`` a point."""
    plan = SMOOTH if ratio < 1.5 else COARSE if ratio < 8 else FINE
    return plan if rays // plan.split >= MIN_RAYS else SMOOTH


def solve(
    receiver: Receiver,
    points: Points,
    trace: Trace,
    occlusion: Occlusion,
    settings: Settings,
    *,
    rays: int,
    noise: float,
) -> Generator[int, None, Solved]:
    """Values of ``points`` out of ``rays`` a point, whose tracing has a relative error of
    ``noise``.  Yields the rays cast so far."""
    parts = parts_of(receiver, points, settings.fit)
    tracer = _Tracer(points, parts, trace, rays)
    yield from _pilot(tracer, settings)
    plans = _plans(tracer, settings, noise)
    yield from _main(tracer, plans, settings)
    traced = tracer.traced
    transfer = traced.values[:, : settings.order**2]
    unseen = buried(traced.origins, traced.normals, transfer, occlusion)
    finish = _Finish(points, parts, plans, settings.order, noise)
    values, hidden = finish.values(traced, unseen)
    fill(points, receiver, values, hidden)
    entry = {
        "rays": tracer.cast + rays_for(transfer),
        "buried_points": int(hidden.sum()),
        **finish.report(traced, unseen, values),
    }
    return Solved(values, entry, traced)


class _Tracer:
    """Traces points and places inside of triangles, and keeps what was found."""

    def __init__(self, points: Points, parts: Parts, trace: Trace, rays: int) -> None:
        self.points, self.parts, self._trace, self.rays = points, parts, trace, rays
        self.cast = 0
        self._homes = parts.homes()
        self._found: list[Traced] = []

    @property
    def traced(self) -> Traced:
        """All that was found."""
        return reduce(Traced.and_, self._found)

    def follow(self, point: Index, inside: Places, split: int) -> Generator[int, None, None]:
        """Trace the points ``point`` and the places ``inside``."""
        corners = self.parts.mesh.corners
        starting, facing = starts(self.parts.surface, corners, self.points.normals, inside)
        origins = _rows(self.points.origins[point], starting)
        normals = _rows(self.points.normals[point], facing)
        order = morton_order(origins.astype(np.float64))
        origins, normals = origins[order], normals[order]
        before, steps = self.cast, self._trace(origins, normals, self.rays // split)
        while True:
            try:
                self.cast = before + next(steps)
            except StopIteration as stop:
                values: Array = stop.value
                break
            yield self.cast
        numbers = np.concatenate([point, np.full(len(inside), -1)])[order]
        places = joined([self._homes[point], inside])[order]
        split_of = np.full(len(order), split)
        self._found.append(Traced(origins, normals, values, numbers, places, split_of))


def _rows(first: Array, then: Float) -> Array:
    return np.concatenate([first, then.astype(np.float32)], dtype=np.float32)


def _pilot(tracer: _Tracer, settings: Settings) -> Generator[int, None, None]:
    """Trace a place in some triangles of each part, and the points at their corners."""
    parts = tracer.parts
    places = []
    for part, (triangles, size) in enumerate(zip(parts.triangles(), parts.sizes(), strict=True)):
        if len(triangles):
            low, high = REST_PILOT if part == parts.rest else PILOT
            count = int(np.clip(size * PILOT_SHARE, low, high))
            areas = parts.surface.areas[triangles]
            places.append(stratified_places(parts.surface, triangles, areas, count, settings.seed))
    inside = joined(places)
    yield from tracer.follow(np.unique(parts.mesh.corners[inside.triangles]), inside, 1)


def _plans(tracer: _Tracer, settings: Settings, noise: float) -> list[Plan]:
    """What the pilot recommends for each part."""
    parts, traced = tracer.parts, tracer.traced
    transfer = traced.values[:, : settings.order**2]
    inside = traced.point < 0
    at_points = np.zeros((parts.mesh.count, transfer.shape[1]), np.float32)
    at_points[traced.point[~inside]] = transfer[~inside]
    places, found = traced.places[inside], transfer[inside]
    dark = ~at_points.any(axis=1)
    lit = found.any(axis=1) & ~dark[parts.mesh.corners[places.triangles]].any(axis=1)
    missed = _squares(found - interpolated(parts.mesh, places, at_points))
    of_noise = noise**2 * _squares(found)
    expected = of_noise * (1 + np.square(places.barycentric).sum(axis=1))
    of = parts.of_triangles[places.triangles]
    plans = []
    for part in range(parts.rest):
        mine = lit & (of == part)
        variance = of_noise[mine].sum()
        excess = (missed - expected)[mine].sum()
        plans.append(choose(excess / variance, tracer.rays) if variance > 0 else POINTS)
    return [*plans, POINTS]


def _main(tracer: _Tracer, plans: list[Plan], settings: Settings) -> Generator[int, None, None]:
    """Trace what ``plans`` want with the rays that the pilot left."""
    parts, pilot = tracer.parts, tracer.traced
    known = np.zeros(parts.mesh.count, bool)
    known[pilot.point[pilot.point >= 0]] = True
    left = parts.sizes() - _places_of_parts(parts, pilot)
    for split in sorted({plan.split for plan in plans}):
        chosen, places = np.zeros(parts.count, bool), []
        for part, triangles in enumerate(parts.triangles()):
            plan = plans[part]
            if plan.split != split:
                continue
            chosen[part] = plan.at_points
            if plan.inside:
                points = (~known & (parts.of_points == part)).sum() if plan.at_points else 0
                places.append(
                    stratified_places(
                        parts.surface, triangles, parts.density(triangles),
                        max(0, int(split * left[part] - points)), settings.seed + 1,
                    )
                )  # fmt: skip
        points = np.flatnonzero(chosen[parts.of_points] & ~known)
        yield from tracer.follow(points, joined(places), split)


def _part_of(parts: Parts, traced: Traced) -> Index:
    at_points = traced.point >= 0
    return np.where(
        at_points, parts.of_points[traced.point], parts.of_triangles[traced.places.triangles]
    )


def _places_of_parts(parts: Parts, traced: Traced) -> Index:
    return np.bincount(_part_of(parts, traced), minlength=parts.count)


def _squares(values: npt.NDArray[Any]) -> Float:
    """The mean square of each row."""
    return np.asarray(np.square(values, dtype=np.float64).mean(axis=1))


@dataclass
class _Errors:
    """Mean squares, for each part (count,): of the transfer, ``size``; of its error over the
    surface, ``surface``; and of what the noise has to do with that, ``noise``."""

    size: Float
    surface: Float
    noise: Float


class _Finish:
    """Turns what was traced into values of the points."""

    def __init__(
        self, points: Points, parts: Parts, plans: list[Plan], order: int, noise: float
    ) -> None:
        self._parts, self._order, self._noise = parts, order, noise
        self._open = sh.open_transfer(points.normals, order).astype(np.float32)
        self._fitted = np.array([plan.inside for plan in plans])
        self._fit_errors = _Errors(*np.zeros((3, parts.count)))

    def values(self, traced: Traced, unseen: Mask) -> tuple[Array, Mask]:
        """Values (P, K), and the points that are buried, with values of 0."""
        parts = self._parts
        values = np.zeros((parts.mesh.count, traced.values.shape[1]), np.float32)
        hidden = np.zeros(len(values), bool)
        at = traced.point >= 0
        values[traced.point[at]] = traced.values[at]
        hidden[traced.point[at]] = unseen[at]
        mine = self._fitted[_part_of(parts, traced)]
        if mine.any():
            points = self._fitted[parts.of_points]
            values[points] = self._fit(traced[mine & ~unseen])[points]
            places = traced.places
            found = buried_points(parts.mesh, places[mine & ~unseen], places[mine & unseen])
            hidden[points] = found[points]
        values[hidden] = 0
        return values, hidden

    def _fit(self, traced: Traced) -> Array:
        """Values (P, K) fitted to ``traced``: their deviation from an open sky's transfer, dimmed
        to what each part sees of it in the mean, is what has to be smooth."""
        parts, columns = self._parts, self._order**2
        of, mesh = _part_of(parts, traced), parts.mesh
        areas = self._areas(traced, of)
        open_here = interpolated(mesh, traced.places, self._open)
        sums = [
            np.bincount(of, areas * np.einsum("sk,sk->s", values, open_here), parts.count)
            for values in (traced.values[:, :columns], open_here)
        ]
        gain = (sums[0] / np.maximum(sums[1], 1e-30)).astype(np.float32)
        noise = traced.split**FALL * np.random.default_rng(0).standard_normal(len(of))
        deviation = np.concatenate([traced.values, noise[:, None].astype(np.float32)], axis=1)
        deviation[:, :columns] -= gain[of][:, None] * open_here
        samples = Samples(traced.places, deviation, areas, of, traced.point < 0)
        fit = Fit(mesh, parts.of_points[mesh.hinges[:, 0]], parts.count)
        weights, missed = fit.weights(samples, columns)
        values = fit.solve(samples, weights)
        self._keep_errors(traced, of, areas, missed, values[:, -1:])
        values[:, :columns] += gain[parts.of_points][:, None] * self._open
        values[:, 0] = np.maximum(values[:, 0], 0)
        return values[:, :-1]

    def _keep_errors(
        self, traced: Traced, of: Index, areas: Float, missed: Float, noise: Array
    ) -> None:
        """What the fit's samples say of its error: ``missed`` (count,) is the mean square of what
        it misses where samples were left out, ``noise`` (P, 1) what it makes of noise alone."""
        inside = traced.point < 0
        weight = np.bincount(of, areas * inside, self._parts.count)

        def mean(values: npt.NDArray[Any]) -> Float:
            sums = np.bincount(of, np.where(inside, areas * values, 0), self._parts.count)
            return np.asarray(sums / np.maximum(weight, 1e-300))

        size = mean(_squares(traced.values[:, : self._order**2]))
        of_places = self._noise**2 * size * mean(traced.split ** (2 * FALL))
        shown = interpolated(self._parts.mesh, traced.places, noise)
        of_noise = self._noise**2 * size * mean(_squares(shown))
        surface = np.maximum(missed - of_places, of_noise)
        self._fit_errors = _Errors(size, surface, of_noise)

    def _areas(self, traced: Traced, of: Index) -> Float:
        """The area (M,) that each place stands for."""
        parts = self._parts
        density = np.ones(len(parts.mesh.corners))
        for triangles in parts.triangles():
            density[triangles] = parts.density(triangles)
        count = np.maximum(np.bincount(of, minlength=parts.count), 1)
        inside = (parts.surface.areas / density)[traced.places.triangles]
        at_points = (parts.point_areas() * parts.sizes()[parts.of_points])[traced.point]
        return np.where(traced.point < 0, inside, at_points) / count[of]

    def report(self, traced: Traced, unseen: Mask, values: Array) -> dict[str, Any]:
        """What the report says of ``values`` and of their errors, relative to the transfer."""
        points = self._point_errors(traced[(traced.point < 0) & ~unseen], values)
        areas = self._parts.areas()

        def pooled(name: str) -> float:
            chosen = np.where(self._fitted, *(getattr(e, name) for e in (self._fit_errors, points)))
            return float((areas * chosen).sum())

        size = max(pooled("size"), 1e-300)
        surface, of_noise = pooled("surface") / size, pooled("noise") / size
        fitted = self._fitted[self._parts.of_points]
        share = float(fitted.mean()) if len(fitted) else 0.0
        squared = float(np.mean(traced.split ** (2 * FALL))) if len(traced.point) else 0.0
        return {
            "values": {"points": 1 - share, "fitted": share},
            "estimated_error": self._noise * squared**0.5,
            "interpolation_error": (surface - of_noise) ** 0.5,
            "surface_error": surface**0.5,
        }

    def _point_errors(self, inside: Traced, values: Array) -> _Errors:
        """What places ``inside`` of the triangles say of ``values`` traced at their corners."""
        parts, columns = self._parts, self._order**2
        transfer, of = inside.values[:, :columns], parts.of_triangles[inside.places.triangles]
        count = np.maximum(np.bincount(of, minlength=parts.count), 1)
        missed = transfer - interpolated(parts.mesh, inside.places, values[:, :columns])
        both = 1 + np.square(inside.places.barycentric).sum(axis=1)
        size = np.bincount(of, _squares(transfer), parts.count) / count
        missed_squares = np.bincount(of, _squares(missed), parts.count) / count
        expected = np.bincount(of, self._noise**2 * size[of] * both, parts.count) / count
        of_noise = self._noise**2 * size / 2  # the mean square of a place's coordinates is a half
        return _Errors(size, np.maximum(missed_squares - expected, 0) + of_noise, of_noise)
