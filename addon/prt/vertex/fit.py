"""Values at vertices that fit what was found inside the triangles.

A least-squares fit weighted by area (Kavan, Bargteil and Sloan, Least Squares Vertex Baking, 2011):
interpolated over the triangles, the values come as near as they can to the samples', where values
of the vertices themselves overshoot on every curve.  Few samples a vertex leave the system nearly
singular, and noise in it; so the jump of the gradient across every edge is held small, with a
weight that predicts samples which were left out best.
"""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import numpy.typing as npt

from ..surface.points import Float, Index
from ..surface.samples import Places
from .fit_mesh import (
    Array,
    Mesh,
    Quadratic,
    excerpt,
    interpolated,
    jump_form,
    lumped,
    right_side,
    sample_form,
)

ANCHOR = 1e-6  # of the diagonal: holds what neither a sample nor an edge holds
ROUGHLY, TOLERANCE = 1e-3, 3e-4  # of the norm of the right side, every row over its diagonal
STEPS = 60
ROWS = 8192  # in one block of a product: it stays in the processor's cache
WEIGHTS = (3.0, 1.0, 0.3, 0.1, 0.03, 0.01, 0.003)  # of the gradient's jumps
LEFT_OUT = 5  # every fifth sample tests a weight
STRETCHES, STRETCH = 12, 2048  # points that choose the weights of a large mesh


class System:
    """A symmetric matrix over the points of a mesh: rows with the most entries first, so that the
    k-th entries of all rows that have one are a slice."""

    def __init__(self, mesh: Mesh) -> None:
        pairs = np.concatenate([mesh.edges, mesh.hinges[:, 2:]])
        rows = np.concatenate([pairs[:, 0], pairs[:, 1]])
        entry = np.tile(np.arange(len(pairs)), 2)
        columns = np.concatenate([pairs[:, 1], pairs[:, 0]])
        degree = np.bincount(rows, minlength=mesh.count)
        self.order = np.argsort(-degree, kind="stable")  # row r is point order[r]
        rank = np.empty_like(self.order)
        rank[self.order] = np.arange(mesh.count)
        by_row = np.argsort(rank[rows], kind="stable")
        starts = np.cumsum(degree[self.order]) - degree[self.order]
        filled = [int((degree > k).sum()) for k in range(int(degree.max(initial=0)))]
        slots = [by_row[starts[:n] + k] for k, n in enumerate(filled)]
        self._columns = [rank[columns[slot]] for slot in slots]
        self._entries = [entry[slot] for slot in slots]
        self._diagonal, self._values = np.empty(0, np.float32), list[Array]()

    def set(self, form: Quadratic, extra: Quadratic) -> None:
        """Make it the matrix of ``form`` plus ``extra``, with a little more on the diagonal."""
        values = np.concatenate([form.edges + extra.edges, form.tips + extra.tips])
        values = values.astype(np.float32)
        diagonal = (form.diagonal + extra.diagonal)[self.order]
        self.anchor = np.maximum(ANCHOR * diagonal, 1e-30).astype(np.float32)[:, None]
        self._diagonal = diagonal.astype(np.float32)[:, None] + self.anchor
        self._values = [values[entries][:, None] for entries in self._entries]

    def product(self, x: Array) -> Array:
        """The matrix times ``x`` (P, K), both in the order of the rows."""
        out = self._diagonal * x
        buffer = np.empty((min(ROWS, len(x)), x.shape[1]), np.float32)
        for start in range(0, len(x), ROWS):
            for columns, values in zip(self._columns, self._values, strict=True):
                stop = min(start + ROWS, len(columns))
                if stop <= start:
                    break
                some = buffer[: stop - start]
                np.take(x, columns[start:stop], axis=0, out=some, mode="clip")
                some *= values[start:stop]
                out[start:stop] += some
        return out

    def solve(self, right: Array, guess: Array, tolerance: float = TOLERANCE) -> Array:
        """The x (P, K) that this matrix takes to ``right`` plus the anchor at ``guess``, both in
        the order of the points; conjugate gradients, each column for itself."""
        right, x = right[self.order], guess[self.order]
        residual: Array = right + self.anchor * x
        size = _dot(residual, residual / self._diagonal)
        residual -= self.product(x)
        scaled = residual / self._diagonal
        towards, energy = scaled, _dot(residual, scaled)
        for _ in range(STEPS):
            if (energy <= tolerance**2 * size).all():
                break
            image = self.product(towards)
            curvature = _dot(towards, image)
            length = _ratio(energy, curvature)
            x += length * towards
            residual -= length * image
            scaled = residual / self._diagonal
            before, energy = energy, _dot(residual, scaled)
            towards *= _ratio(energy, before)
            towards += scaled
        out = np.empty_like(x)
        out[self.order] = x
        return out


def _dot(a: npt.NDArray[Any], b: npt.NDArray[Any]) -> Float:
    """Products (K,) of the columns."""
    return np.asarray((a * b).sum(axis=0, dtype=np.float64))


def _ratio(a: Float, b: Float) -> Array:
    return np.asarray(a / np.where(b > 0, b, 1) * (b > 0), np.float32)


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

    def __init__(self, mesh: Mesh, parts: Index, count: int) -> None:
        self._mesh, self._parts, self._count = mesh, parts, count
        self._system = System(mesh)

    def solve(self, samples: Samples, weights: Float) -> Array:
        """Values (P, K) at the points that fit those of the samples, with each part's weight."""
        data, right, guess = self._sides(samples)
        jumps = jump_form(self._mesh, weights[self._parts[self._mesh.hinges[:, 0]]])
        self._system.set(data, jumps)
        return self._system.solve(right, guess)

    def _sides(self, samples: Samples) -> tuple[Quadratic, Array, Array]:
        """The samples' form, the right side (P, K) that goes with it, and where to start (P, K)."""
        places, areas, values = samples.places, samples.areas, samples.values
        data = sample_form(self._mesh, places, areas)
        sums = right_side(self._mesh, places, areas, values)
        return data, sums, lumped(self._mesh, places, areas, sums)

    def judged(self, samples: Samples, weights: tuple[float, ...]) -> tuple[Float, Float]:
        """For each part (count,) the weight out of ``weights``, largest first, that predicts
        samples left out best, or a smaller one that does so as far as they can tell; and the mean
        square of what it then misses."""
        rank = np.cumsum(samples.spare)
        out = samples.spare & (rank % LEFT_OUT == LEFT_OUT // 2)
        kept, tests = samples[~out], samples[out]
        data, right, values = self._sides(kept)
        jumps = jump_form(self._mesh, np.ones(len(self._mesh.hinges)))
        squares = np.empty((len(weights), len(tests.areas)))
        for i, weight in enumerate(weights):  # each starts from the last one's values
            self._system.set(data, jumps.times(weight))
            values = self._system.solve(right, values, ROUGHLY)
            missed = interpolated(self._mesh, tests.places, values) - tests.values
            squares[i] = tests.areas * np.square(missed, dtype=np.float64).mean(axis=1)
        return self._choose(squares, tests, np.array(weights))

    def _choose(self, squares: Float, tests: Samples, weights: Float) -> tuple[Float, Float]:
        """See ``judged``; ``squares`` (W, S) of what ``tests`` miss.  A part without tests is as
        all together."""

        def sums(values: Float) -> Float:
            of_parts = np.bincount(tests.parts, values, self._count)
            return np.where(has, of_parts, values.sum())

        has = np.bincount(tests.parts, minlength=self._count) > 0
        totals = np.array([sums(row) for row in squares])
        best = np.argmin(totals, axis=0)
        least = squares[best[tests.parts], np.arange(len(tests.areas))]
        chosen = best.copy()
        for i, row in enumerate(squares):
            doubt = np.sqrt(sums((row - least) ** 2))  # a standard error of the difference
            chosen = np.where((i > best) & (totals[i] - sums(least) <= doubt), i, chosen)
        area = np.maximum(sums(tests.areas), 1e-300)
        return weights[chosen], totals[chosen, np.arange(self._count)] / area


def best_weights(
    mesh: Mesh,
    samples: Samples,
    parts: Index,
    count: int,
    weights: tuple[float, ...] = WEIGHTS,
) -> tuple[Float, Float]:
    """For each part the weight of the jumps that predicts samples left out best, and the mean
    square of what it then misses.  A large mesh is judged by some stretches of its points, which
    lie together because they are numbered along a Z curve."""
    if mesh.count > 5 * STRETCHES * STRETCH // 4:
        keep = np.arange(mesh.count) % (mesh.count // STRETCHES) < STRETCH
        inside = keep[mesh.corners].all(axis=1)
        number = np.cumsum(inside) - 1
        mesh, parts = excerpt(mesh, keep), parts[keep]
        samples = samples[inside[samples.places.triangles]]
        places = Places(number[samples.places.triangles], samples.places.barycentric)
        samples = replace(samples, places=places)
    return Fit(mesh, parts, count).judged(samples, weights)
