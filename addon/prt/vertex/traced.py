"""Places that rays start from, at points and inside of triangles, and what was found there."""

from collections.abc import Generator
from dataclasses import dataclass
from functools import reduce
from typing import Any, Protocol

import numpy as np
import numpy.typing as npt

from ..surface.points import Float, Index, Points, morton_order
from ..surface.samples import Places, starts
from .parts import Parts, joined

Array = npt.NDArray[np.float32]
Mask = npt.NDArray[np.bool_]

FEW = 64  # one place of so many may lie anywhere
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
    on the mesh; how many ``rays`` (M,) each took; and how many times ``noisier`` (M,) it is than a
    point with all its rays."""

    origins: Array
    normals: Array
    values: Array
    point: Index
    places: Places
    rays: Index
    noisier: Float

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
class Found:
    """``values`` (P, K) of points, or texels; ``entry``, what the report says about them;
    ``traced``, places that rays started from."""

    values: Array
    entry: dict[str, Any]
    traced: Traced


class Caster:
    """Has places traced; ``cast`` is the rays so far."""

    def __init__(self, trace: Trace) -> None:
        self._trace, self.cast = trace, 0

    def cast_from(self, origins: Array, normals: Array, rays: int) -> Generator[int, None, Array]:
        """What is found (M, K) with ``rays`` a place; neighbours are best next to each other.
        Yields the rays cast so far."""
        before, steps = self.cast, self._trace(origins, normals, rays)
        while True:
            try:
                self.cast = before + next(steps)
            except StopIteration as stop:
                found: Array = stop.value
                return found
            yield self.cast


class Tracer(Caster):
    """Traces points and places inside of triangles, and keeps what was found."""

    def __init__(self, points: Points, parts: Parts, trace: Trace, rays: int) -> None:
        super().__init__(trace)
        self.points, self.parts, self.rays = points, parts, rays
        self._homes = parts.homes()
        self._found: list[Traced] = []

    @property
    def traced(self) -> Traced:
        """All that was found."""
        none = np.zeros(0, np.int64)
        nothing = np.zeros((0, 3), np.float32)
        start = Traced(nothing, nothing, nothing, none, joined([]), none, np.zeros(0))
        self._found = [reduce(Traced.and_, self._found)] if self._found else []
        return self._found[0] if self._found else start

    def follow(self, point: Index, inside: Places, rays: int) -> Generator[int, None, None]:
        """Trace the points ``point`` and the places ``inside`` with ``rays`` each."""
        if not len(point) and not len(inside):
            return
        corners = self.parts.mesh.corners
        starting, facing = starts(self.parts.surface, corners, self.points.normals, inside)
        origins = _rows(self.points.origins[point], starting)
        normals = _rows(self.points.normals[point], facing)
        numbers = np.concatenate([point, np.full(len(inside), -1)])
        places = joined([self._homes[point], inside])
        if len(inside) * FEW > len(point):  # else they are in the order of a Z curve, but for a few
            order = morton_order(origins.astype(np.float64))
            origins, normals = origins[order], normals[order]
            numbers, places = numbers[order], places[order]
        values = yield from self.cast_from(origins, normals, rays)
        noisier = np.full(len(numbers), (self.rays / rays) ** FALL)
        rays_of = np.full(len(numbers), rays)
        self._found.append(Traced(origins, normals, values, numbers, places, rays_of, noisier))

    def left(self) -> Float:
        """For each part (count,) how many places with all their rays are still to be paid."""
        traced = self.traced
        paid = np.bincount(part_of(self.parts, traced), traced.rays / self.rays, self.parts.count)
        return np.asarray(self.parts.sizes() - paid)

    def known(self) -> Mask:
        """The points (P,) that were traced."""
        known, point = np.zeros(self.parts.mesh.count, bool), self.traced.point
        known[point[point >= 0]] = True
        return known


def _rows(first: Array, then: Float) -> Array:
    return np.concatenate([first, then.astype(np.float32)], dtype=np.float32)


def part_of(parts: Parts, traced: Traced) -> Index:
    """The part (M,) of each place."""
    inside = parts.of_triangles[traced.places.triangles]
    return np.where(traced.point >= 0, parts.of_points[traced.point], inside)
