"""The measured error of a bake: some of it traced again by brute force.

The reference knows nothing of the baker's short cuts: each point sums the basis over its own world
directions, with a ray each, in float64 and without the correction.
"""

from collections.abc import Callable, Generator, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from . import sh
from .bounces.walks import Walls, walk
from .job import ALL, Receiver, Settings
from .surface.points import Float, Points, Surface, element_triangles
from .surface.samples import Places, random_places, starts
from .tracing.buried import buried, rays_for
from .tracing.hemisphere import cosine_fibonacci, frames
from .tracing.rays import Occlusion
from .tracing.transfer import relative_rms
from .tracing.visibility import EVERYTHING, even_hemisphere
from .vertex.traced import Traced

MOST_STEPS = 256  # of a walk, where bounces go on until nothing is left
EDGES = np.concatenate([[0.0], np.geomspace(1e-3, 1.0, 13), [np.inf]])  # of relative errors


@dataclass(frozen=True)
class Light:
    """The light that was baked: ``radiance_sh`` (n², 3), and ``exact``, which takes places and unit
    normals (P, 3) to the exit radiance (P, 3) of a white surface there."""

    radiance_sh: Float
    exact: Callable[[Float, Float], Float]


@dataclass(frozen=True)
class Measured:
    """Relative RMS errors of the transfer: ``at_points``, where it was traced (the rays' noise),
    and ``on_surface``, between the vertices too (noise and the mesh's coarseness); ``histogram``
    of the latter, point by point: ``counts`` between ``edges``, the last of them without end; and
    the same two errors of the exit radiance at the baked light and of the visibility, None without
    one.  ``at_points`` is None where it is not known where that was."""

    at_points: float | None
    on_surface: float
    points: int
    rays: int
    histogram: dict[str, list[Any]]
    light_at_points: float | None = None
    light_on_surface: float | None = None
    visibility_at_points: float | None = None
    visibility_on_surface: float | None = None


@dataclass(frozen=True)
class Shown:
    """Places, ``origins`` and ``normals`` (P, 3), and what is shown there: transfer (P, channels,
    n²), residual (P, 3) or None, and visibility (P, v²), v may be 0."""

    origins: Float
    normals: Float
    transfer: Float
    residual: Float | None
    visibility_sh: Float


def random_surface_points(receiver: Receiver, count: int, seed: int) -> Shown:
    """``count`` points, uniform over the area of ``receiver``, which has its transfer."""
    assert receiver.transfer is not None
    places = random_places(Surface.of(receiver).areas, count, seed)
    elements = element_triangles(receiver)[places.triangles]

    def shown(values: npt.NDArray[Any]) -> Float:
        corners = values[elements].astype(np.float64)
        return np.asarray(np.einsum("pk,pk...->p...", places.barycentric, corners))

    residual = receiver.residual
    has_residual = residual is not None and residual.shape[1]
    return shown_at(
        receiver,
        places,
        shown(receiver.transfer),
        shown(residual[:, 0]) if residual is not None and has_residual else None,
        None if receiver.visibility_sh is None else shown(receiver.visibility_sh),
    )


def shown_at(
    receiver: Receiver,
    places: Places,
    transfer: Float,
    residual: Float | None,
    visibility_sh: Float | None,
) -> Shown:
    """What is shown at ``places`` (P,) of ``receiver``: ``transfer`` (P, channels, n²), and, each
    may be None, ``residual`` (P, 3) and ``visibility_sh`` (P, v²)."""
    surface, rows = Surface.of(receiver), element_triangles(receiver)
    seen = np.empty((len(places), 0)) if visibility_sh is None else visibility_sh
    return Shown(*starts(surface, rows, receiver.normals, places), transfer, residual, seen)


def brute_force(
    origins: Float, normals: Float, occlusion: Occlusion, settings: Settings, out: Float
) -> Iterator[int]:
    """Fill ``out`` (P, channels, n²) with the transfer at ``origins`` (P, 3) about unit
    ``normals`` (P, 3), by ``verify_rays`` rays each, and yield the rays cast so far."""
    rays = settings.verify_rays
    azimuth = np.random.default_rng([settings.seed, 7]).random(len(normals)) * 2 * np.pi
    local = cosine_fibonacci(rays)
    for p, matrix in enumerate(frames(normals, azimuth).matrices()):
        directions = local @ matrix.T.astype(np.float64)
        start = np.repeat(origins[p : p + 1].astype(np.float32), rays, axis=0)
        mask = occlusion.sky_mask(start, directions.astype(np.float32))
        out[p] = sh.basis(directions[mask != 0], settings.order).sum(axis=0) / rays
        yield (p + 1) * rays


def seen_by_brute_force(
    origins: Float, normals: Float, occlusion: Occlusion, settings: Settings, out: Float
) -> Iterator[int]:
    """Fill ``out`` (P, v²) with the coefficients of what is seen from ``origins`` (P, 3), with all
    below the horizon of unit ``normals`` (P, 3), by ``verify_rays`` rays each, one for equal solid
    angles, and yield the rays cast so far."""
    rays, order = settings.verify_rays, sh.order_of(out.shape[1])
    local = even_hemisphere(rays)
    for p, matrix in enumerate(frames(normals, np.zeros(len(normals))).matrices()):
        directions = local @ matrix.T.astype(np.float64)
        start = np.repeat(origins[p : p + 1].astype(np.float32), rays, axis=0)
        blocked = occlusion.sky_mask(start, directions.astype(np.float32)) == 0
        out[p] = -2 * np.pi / rays * sh.basis(directions[blocked], order).sum(axis=0)
        out[p, 0] += EVERYTHING
        yield (p + 1) * rays


def _reference(  # noqa: PLR0917 - all of a trace
    origins: Float,
    normals: Float,
    occlusion: Occlusion,
    settings: Settings,
    walls: Walls | None,
    out: Float,
) -> Iterator[int]:
    if walls is None:
        return brute_force(origins, normals, occlusion, settings, out)
    return random_walks(origins, normals, walls, settings, out)


def random_walks(
    origins: Float, normals: Float, walls: Walls, settings: Settings, out: Float
) -> Iterator[int]:
    """As ``brute_force``, with light that bounces off ``walls``; ``out`` (P, channels, n²)."""
    bounces = settings.bounces if settings.bounces != ALL else MOST_STEPS
    rays, order = settings.verify_rays, settings.order
    steps = walk(origins, normals, walls, rays, bounces, order, settings.seed)
    for p, (found, cast) in enumerate(steps):
        out[p] = found if out.shape[1] == 3 else found.mean(axis=0)
        yield cast


def measure(
    receiver: Receiver,
    points: Points | None,
    occlusion: Occlusion,
    settings: Settings,
    *,
    traced: Traced | None = None,
    light: Light | None = None,
    walls: Walls | None = None,
    surface: Shown | None = None,
) -> Generator[int, None, Measured]:
    """Trace ``verify_points`` random points of the surface, and as many of the places that were
    ``traced`` (the points, where that isn't known), again.  ``surface`` is what is shown at random
    places, where that is not in the receiver's elements.

    Yields the rays cast so far; the errors are the generator's value.  Places inside of other
    things, which nobody sees, don't count.  Where light bounces off ``walls`` the reference are
    random walks, which have some noise of their own; places that were traced say nothing then,
    since they know the direct light alone, and the points do.
    """
    if surface is None:
        surface = random_surface_points(receiver, settings.verify_points, settings.seed)
    count = len(surface.origins)
    if traced is not None and walls is None:
        at = _at_traced(traced, settings)
    elif points is not None:
        at = _at_points(receiver, points, count)
    else:
        nothing = (surface.transfer[:0], None, surface.visibility_sh[:0])
        at = Shown(surface.origins[:0], surface.normals[:0], *nothing)
    origins = np.concatenate([surface.origins, at.origins])
    normals = np.concatenate([surface.normals, at.normals])
    channels = surface.transfer.shape[1]
    reference = np.empty((len(origins), channels, settings.order**2))
    cast = 0
    for cast in _reference(origins, normals, occlusion, settings, walls, reference):
        yield cast
    seen = ~buried(origins.astype(np.float32), normals.astype(np.float32), reference, occlusion)
    shown_sh = np.concatenate([surface.visibility_sh, at.visibility_sh])
    seen_sh, before = np.empty_like(shown_sh), cast
    if shown_sh.shape[1]:
        for more in seen_by_brute_force(origins, normals, occlusion, settings, seen_sh):
            cast = before + more
            yield cast
    here, there = slice(count, None), slice(count)
    at_points, _, light_at_points = _errors(at, reference[here], seen[here], light)
    on_surface, each, light_on_surface = _errors(surface, reference[there], seen[there], light)
    return Measured(
        at_points if len(at.origins) else None,
        on_surface,
        len(origins),
        cast + rays_for(reference),
        {"edges": EDGES[:-1].tolist(), "counts": np.histogram(each, EDGES)[0].tolist()},
        light_at_points if len(at.origins) else None,
        light_on_surface,
        _of_visibility(shown_sh[here], seen_sh[here], seen[here]),
        _of_visibility(shown_sh[there], seen_sh[there], seen[there]),
    )


def _of_visibility(shown: Float, expected: Float, seen: npt.NDArray[np.bool_]) -> float | None:
    """Relative RMS error of coefficients (P, v²) at the places that are ``seen`` (P,); None of
    none."""
    return relative_rms(shown[seen], expected[seen]) if shown.size and seen.any() else None


def _errors(
    shown: Shown, reference: Float, seen: npt.NDArray[np.bool_], light: Light | None
) -> tuple[float, Float, float | None]:
    """Relative RMS error of the transfer where it is ``seen``, each place's own (S,), relative to
    the RMS size of all, and that of the exit radiance."""
    expected = reference[seen]
    squares = np.square(shown.transfer[seen] - expected).mean(axis=(1, 2))
    size = max(float(np.square(expected).mean()) if expected.size else 0.0, 1e-300)
    of_light = None
    if light is not None:
        exact = light.exact(shown.origins[seen], shown.normals[seen])
        of_light = relative_rms(exit_radiance(shown, light)[seen], exact)
    of_transfer = relative_rms(shown.transfer[seen], expected)
    return of_transfer, np.sqrt(np.minimum(squares / size, 1e6)), of_light


def exit_radiance(shown: Shown, light: Light) -> Float:
    """What the bake shows at ``shown`` under the light it was baked for, (P, 3)."""
    radiance = np.asarray(light.radiance_sh, np.float64)
    channels = np.broadcast_to(shown.transfer, (len(shown.transfer), 3, radiance.shape[0]))
    values = np.einsum("pci,ic->pc", channels, radiance)
    if shown.residual is not None:
        values = values + shown.residual
    return np.asarray(np.maximum(values, 0))


def _at_points(receiver: Receiver, points: Points, count: int) -> Shown:
    """What the receiver's elements show at ``count`` of the points."""
    assert receiver.transfer is not None
    chosen = _spread(len(points.origins), count)
    element = np.zeros(len(points.origins), np.int64)
    seen = np.flatnonzero(points.element_points >= 0)
    element[points.element_points[seen]] = seen
    rows = element[chosen]
    residual = receiver.residual
    return Shown(
        points.origins[chosen].astype(np.float64),
        points.normals[chosen].astype(np.float64),
        receiver.transfer[rows].astype(np.float64),
        None if residual is None or not residual.shape[1] else residual[rows, 0],
        _of_elements(receiver)[rows],
    )


def _of_elements(receiver: Receiver) -> Float:
    """The visibility (E, v²) of a receiver's elements."""
    assert receiver.transfer is not None
    if receiver.visibility_sh is None:
        return np.empty((len(receiver.transfer), 0))
    return receiver.visibility_sh.astype(np.float64)


def _at_traced(traced: Traced, settings: Settings) -> Shown:
    """What was found at some of the places that were traced."""
    chosen, columns = _spread(len(traced.origins), settings.verify_points), settings.order**2
    values = traced.values[chosen].astype(np.float64)
    seen = values.shape[1] - settings.visibility_order**2
    residual = values[:, columns : min(columns + 3, seen)]
    return Shown(
        traced.origins[chosen].astype(np.float64),
        traced.normals[chosen].astype(np.float64),
        values[:, None, :columns],
        residual if residual.shape[1] == 3 else None,
        values[:, seen:],
    )


def _spread(size: int, count: int) -> npt.NDArray[np.int64]:
    """At most ``count`` numbers spread over those below ``size``."""
    return np.unique(np.linspace(0, max(0, size - 1), min(count, size)).astype(np.int64))
