"""Values at vertices that fit what was found inside the triangles.

A least-squares fit weighted by area (Kavan, Bargteil and Sloan, Least Squares Vertex Baking, 2011):
interpolated over the triangles, the values come as near as they can to the samples', where values
of the vertices themselves overshoot on every curve.  Few samples a vertex leave the system nearly
singular, and noise in it; so the jump of the gradient across every edge is held small, with a
weight that predicts samples which were left out best.

Shadows bend values at few edges and hardly anywhere else.  A square holds a large jump too much
and noise too little, so a first fit tells how far the values bend at each edge, and a second one
holds it by a weight that falls with that (the reweighted squares of a penalty that grows as the
logarithm).  At equal rays that takes a tenth of the error, a fifth at most.
"""

from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from ..surface.points import Float, Index
from ..surface.samples import Places
from .fit_mesh import (
    Array,
    Mesh,
    Quadratic,
    Spread,
    bends,
    excerpt,
    interpolated,
    jump_form,
    sample_form,
)
from .system import TOLERANCE, System

JUDGED, FIRST = 1e-3, 1e-2  # how near a fit is that is judged, and the first of two
WEIGHTS = (3.0, 1.0, 0.3, 0.1, 0.03, 0.01, 0.003)  # of the gradient's jumps
LEFT_OUT = 5  # every fifth sample tests a weight
STIFFER = (3.0, 1.0)  # times the first fit's weights may be the second's
USUAL = 3.0  # times the square of the mean bend: there an edge is held by its weight
SHARP = 0.1  # of that bends so little that less makes no difference
STRETCHES, STRETCH = 12, 2048  # points that choose the weights of a large mesh


@dataclass(frozen=True)
class Samples:
    """What was found on a mesh: ``places``, ``values`` (S, K) there, the area (S,) that each stands
    for, the part (S,) of the mesh it is in, and which may be left out to test a fit, ``spare``."""

    places: Places
    values: Array
    areas: Float
    parts: Index
    spare: npt.NDArray[np.bool_]

    def __getitem__(self, chosen: npt.NDArray[np.bool_]) -> "Samples":
        return Samples(
            self.places[chosen], self.values[chosen], self.areas[chosen], self.parts[chosen],
            self.spare[chosen],
        )  # fmt: skip


class Fit:
    """Fits of values at the points of a ``mesh``, whose points lie in ``parts`` (P,), numbered
    below ``count``; each part has its own weight of the gradient's jumps."""

    def __init__(self, mesh: Mesh, parts: Index, count: int, threads: int = 0) -> None:
        self._mesh, self._parts, self._count = mesh, parts, count
        self._system = System(mesh, threads)

    def solve(
        self,
        samples: Samples,
        weights: Float,
        columns: int,
        rough: int = 0,
        tolerance: float = TOLERANCE,
    ) -> tuple[Array, Array]:
        """Values (P, K) at the points that fit those of the samples to within this ``tolerance``,
        with each part's ``weights`` (count, 2) of both fits.  Fitted twice are the first
        ``columns``, as they bend, and the last ``rough`` ones, which are as near as they come
        meanwhile; what lies between, the light of one world, bends at other edges.  And what the
        second fit took from the first ``columns`` (P, columns)."""
        data, right, guess = self._sides(samples)
        self._first = data, self._of_parts(weights[:, 0])
        self._hold(*self._first)
        column = np.arange(right.shape[1])
        is_rough = column >= len(column) - rough
        twice = is_rough | (column < columns)
        found = self._system.solve(right, guess, np.where(twice, FIRST, tolerance))
        first = found[:, :columns].copy()
        self._second = data, self._of_parts(weights[:, 1]) * self._stiffness(first)
        self._hold(*self._second)
        near = np.where(is_rough, 1.0, tolerance)[twice]
        found[:, twice] = self._system.solve(right[:, twice], found[:, twice], near)
        return found, first - found[:, :columns]

    def _hold(self, data: Quadratic, weights: Float) -> None:
        """Make it the system of ``data`` with such a weight (H,) at each hinge."""
        self._system.set(data, jump_form(self._mesh, weights))

    def _of_parts(self, values: Float) -> Float:
        """At each hinge (H,) its part's of ``values`` (count,)."""
        return np.asarray(values[self._parts[self._mesh.hinges[:, 0]]])

    def _stiffness(self, values: Array) -> Float:
        """By what each hinge's weight is multiplied (H,) where ``values`` (P, K) bend as they do:
        1 where they bend as is usual in the part, up to 1 + 1 / SHARP where they hardly do."""
        of, squared = self._parts[self._mesh.hinges[:, 0]], bends(self._mesh, values)
        sums = np.bincount(of, np.sqrt(squared), self._count)
        mean = sums / np.maximum(np.bincount(of, minlength=self._count), 1)
        usual = np.maximum(USUAL * mean**2, 1e-300)[of]
        return np.asarray((1 + SHARP) / (squared / usual + SHARP))

    def again(self, values: Array, columns: int, tolerance: float) -> Array:
        """Fits to other ``values`` (S, K) of the samples that were fitted last, to within this
        ``tolerance``: the second one to the first ``columns``, and the first to the others."""
        right = self._spread.sums(values)
        guess, found = self._spread.averages(right), np.empty_like(right)
        for held, its in ((self._second, slice(columns)), (self._first, slice(columns, None))):
            if right[:, its].size:
                self._hold(*held)
                found[:, its] = self._system.solve(right[:, its], guess[:, its], tolerance)
        return found

    def averages(self, values: Array) -> Array:
        """Averages (P, K) about each point of other ``values`` (S, K) of the samples that were
        fitted last."""
        return self._spread.averages(self._spread.sums(values))

    def _sides(self, samples: Samples) -> tuple[Quadratic, Array, Array]:
        """The samples' form, the right side (P, K) that goes with it, and where to start (P, K)."""
        self._spread = Spread(self._mesh, samples.places, samples.areas)
        right = self._spread.sums(samples.values)
        data = sample_form(self._mesh, samples.places, samples.areas)
        return data, right, self._spread.averages(right)

    def judged(
        self, samples: Samples, weights: tuple[float, ...], stiffer: tuple[float, ...]
    ) -> tuple[Float, Float]:
        """For each part the weights (count, 2) of both fits: that out of ``weights``, largest
        first, with which the first predicts samples left out best, or a smaller one that does so
        as far as they can tell, and so many times ``stiffer`` as the second does; and the mean
        square (count,) of what it then misses.  Without a ``stiffer`` it is left at the first."""
        rank = np.cumsum(samples.spare)
        out = samples.spare & (rank % LEFT_OUT == LEFT_OUT // 2)
        kept, tests = samples[~out], samples[out]
        data, right, values = self._sides(kept)
        jumps = jump_form(self._mesh, np.ones(len(self._mesh.hinges)))
        found, squares = list[Array](), list[Float]()
        for weight in weights:  # each starts from the last one's values
            self._system.set(data, jumps.times(weight))
            values = self._system.solve(right, values, JUDGED)
            found.append(values)
            squares.append(self._missed(tests, values))
            chosen, missed = self._best(tests, squares, doubting=True)
            if (chosen < len(squares) - 1).all():  # the smaller ones would miss more still
                break
        first = second = np.array(weights)[chosen]
        if stiffer:
            values = np.choose(chosen[self._parts][:, None], found)
            stiffness, squares = self._stiffness(values), []
            for times in stiffer:
                self._hold(data, times * self._of_parts(first) * stiffness)
                values = self._system.solve(right, values, JUDGED)
                squares.append(self._missed(tests, values))
            chosen, missed = self._best(tests, squares)
            second = first * np.array(stiffer)[chosen]
        return np.stack([first, second], axis=1), missed

    def _best(
        self, tests: Samples, squares: list[Float], doubting: bool = False
    ) -> tuple[Index, Float]:
        """Which of some fits, of what they miss of ``tests`` the ``squares``, (S,) each, misses the
        least in each part (count,), the last that does as far as these can tell where one is
        ``doubting``; and the mean square that it misses."""
        totals = np.array([self._sums(row, tests) for row in squares])
        best = np.argmin(totals, axis=0)
        least = np.stack(squares)[best[tests.parts], np.arange(len(tests.areas))]
        smallest, chosen = self._sums(least, tests), best.copy()
        for i, row in enumerate(squares if doubting else ()):
            doubt = np.sqrt(self._sums((row - least) ** 2, tests))  # of the difference
            near = totals[i] - smallest <= doubt
            chosen = np.where((i > best) & near, i, chosen)
        area = np.maximum(self._sums(tests.areas, tests), 1e-300)
        return chosen, totals[chosen, np.arange(self._count)] / area

    def _missed(self, tests: Samples, values: Array) -> Float:
        """The mean square of what ``values`` (P, K) miss of each of ``tests`` (S,), by its area."""
        missed = interpolated(self._mesh, tests.places, values) - tests.values
        return np.asarray(tests.areas * np.square(missed, dtype=np.float64).mean(axis=1))

    def _sums(self, values: Float, tests: Samples) -> Float:
        """Over each part (count,) of ``values`` (S,) of ``tests``; where it has none, over all."""
        of_parts = np.bincount(tests.parts, values, self._count)
        has = np.bincount(tests.parts, minlength=self._count) > 0
        return np.where(has, of_parts, values.sum())


def best_weights(
    mesh: Mesh,
    samples: Samples,
    parts: Index,
    count: int,
    *,
    weights: tuple[float, ...] = WEIGHTS,
    stiffer: tuple[float, ...] = STIFFER,
    threads: int = 0,
) -> tuple[Float, Float]:
    """For each part the weights of both fits that predict samples left out best, and the mean
    square of what is then missed, as ``Fit.judged`` has them.  A large mesh is judged by some
    stretches of its points, which lie together because they are numbered along a Z curve."""
    if mesh.count > 5 * STRETCHES * STRETCH // 4:
        keep = np.arange(mesh.count) % (mesh.count // STRETCHES) < STRETCH
        inside = keep[mesh.corners].all(axis=1)
        number = np.cumsum(inside) - 1
        mesh, parts = excerpt(mesh, keep), parts[keep]
        samples = samples[inside[samples.places.triangles]]
        places = Places(number[samples.places.triangles], samples.places.barycentric)
        samples = replace(samples, places=places)
    return Fit(mesh, parts, count, threads).judged(samples, weights, stiffer)
