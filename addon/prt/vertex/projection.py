"""Values of points from what more was found at the places that were traced: light of bounces.

What was traced first has decided how the points are found: as they are, or by a fit with some
weight.  Light that bounces is smoother than that, so it is fitted once, with the same weights, when
all of it is known.  What the next bounce reads on the way there are averages of the samples about
each point: they are not smooth enough to be shown, but add up to the same light.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from ..surface.points import Index
from .fit import Fit, Samples
from .fit_mesh import averages
from .parts import Parts
from .traced import Array, Mask, Traced, part_of
from .values import Values

Solver = Callable[[Samples], Array]


@dataclass(frozen=True)
class Projection:
    """From M places ``traced`` to the P points of ``parts``, as ``first`` found their values: by
    fits to the places that are not ``unseen`` (M,), or as they are.  Points ``hidden`` (P,) are
    black but for ``filled`` (B,) of them, which show what ``givers`` (B,) show."""

    parts: Parts
    first: Values
    traced: Traced
    unseen: Mask
    hidden: Mask
    filled: Index
    givers: Index

    def rough(self, found: Array) -> Array:
        """Averages (P, K) of what was ``found`` (M, K)."""
        return self._shown(found, self._averages)

    def final(self, found: Array) -> Array:
        """What points (P, K) show of what was ``found`` (M, K)."""
        return self._shown(found, self._fit)

    def _shown(self, found: Array, of_samples: Solver) -> Array:
        at, mesh = self.traced.point >= 0, self.parts.mesh
        values = np.zeros((mesh.count, found.shape[1]), np.float32)
        values[self.traced.point[at]] = found[at]
        mine, samples = self._fitted
        if mine.any():
            points = self.first.fitted[self.parts.of_points]
            values[points] = of_samples(replace(samples, values=found[mine]))[points]
        values[self.hidden] = 0
        values[self.filled] = values[self.givers]
        return values

    @cached_property
    def _fitted(self) -> tuple[Mask, Samples]:
        """Which of the places (M,) count in a fit, and these without what was found there."""
        mine = self.first.fitted[part_of(self.parts, self.traced)] & ~self.unseen
        its = self.traced[mine]
        parts, nothing = part_of(self.parts, its), np.empty((0, 0), np.float32)
        return mine, Samples(its.places, nothing, self.first.areas(its), parts, its.point < 0)

    def _averages(self, samples: Samples) -> Array:
        return averages(self.parts.mesh, samples.places, samples.areas, samples.values)

    def _fit(self, samples: Samples) -> Array:
        parts, threads = self.parts, self.first.threads
        fit = Fit(parts.mesh, parts.of_points, parts.count, threads)
        return fit.solve(samples, self.first.weights)
