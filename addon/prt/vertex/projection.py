"""Values of points from what more was found at the places that were traced: light of bounces.

What was traced first has decided how the points are found: as they are, or by a fit with some
weight.  Light that bounces is smoother than that, so it is fitted once, with the same weights, when
all of it is known.  What the next bounce reads on the way there are averages of the samples about
each point: they are not smooth enough to be shown, but add up to the same light.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import numpy as np

from ..surface.points import Index
from .parts import Parts
from .traced import Array, Mask, Traced, part_of
from .values import Values, squares

CLOSELY = 2e-3  # of all light: the norm of what a fit of light that bounced may miss
CLOSELY_ENOUGH = 1e-2  # of the light that bounced


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
        return self._shown(found, self.first.fit.averages if self.first.fit else None)

    def final(self, found: Array, columns: int) -> Array:
        """What points (P, K) show of what was ``found`` (M, K), whose first ``columns`` are the
        transfer's, and the others what is exact for one world."""
        fit = self.first.fit
        if fit is None:
            return self._shown(found, None)
        direct, added = (squares(v[:, :1]).mean() ** 0.5 for v in (self.traced.values, found))
        tolerance = min(CLOSELY * (direct + added) / max(added, 1e-30), CLOSELY_ENOUGH)
        return self._shown(found, partial(fit.again, columns=columns, tolerance=tolerance))

    def _shown(self, found: Array, of_samples: Callable[[Array], Array] | None) -> Array:
        at, mesh = self.traced.point >= 0, self.parts.mesh
        values = np.zeros((mesh.count, found.shape[1]), np.float32)
        values[self.traced.point[at]] = found[at]
        if of_samples is not None:
            mine = self.first.fitted[part_of(self.parts, self.traced)] & ~self.unseen
            points = self.first.fitted[self.parts.of_points]
            values[points] = of_samples(found[mine])[points]
        values[self.hidden] = 0
        values[self.filled] = values[self.givers]
        return values
