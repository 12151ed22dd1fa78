"""Values of points from what was traced, with and without a fit, and how wrong they are."""

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
import numpy.typing as npt

from .. import sh
from ..job import Settings
from ..surface.points import Float, Index, Points
from .fit import STIFFER, WEIGHTS, Fit, Samples, best_weights
from .fit_mesh import interpolated
from .parts import Parts, buried_points
from .traced import Array, Mask, Traced, part_of

NEAR, NEAREST = 0.1, (1e-4, 1e-3)  # of the noise may a fit err, but no less and no more
TRIAL = (1.0, 0.1)  # weights that tell whether a fit is promising
WORSE = 1.5  # times the mean square that points miss: more than a fit loses by samples left out


@dataclass
class Errors:
    """Mean squares, for each part (count,): of the transfer, ``size``; of its error over the
    surface, ``surface``; and of what the noise has to do with that, ``noise``."""

    size: Float
    surface: Float
    noise: Float


class Values:
    """Turns what was traced into values of the points.

    ``fitted`` (count,) are the parts whose values are fitted, and ``fit`` what fitted them, where
    more that is found at the same places will be.
    """

    def __init__(
        self, points: Points, parts: Parts, fitted: Mask, settings: Settings, noise: float
    ) -> None:
        self._parts, self._noise, self.fitted = parts, noise, fitted
        self._order, self.threads, self._points = settings.order, settings.threads, points
        self._is_fitted_again = bool(settings.bounces)
        self._fit_errors = Errors(*np.zeros((3, parts.count)))
        self._judged: tuple[Float, Float] | None = None
        self.fit: Fit | None = None

    @cached_property
    def _open(self) -> Array:
        """An open sky's transfer of the points (P, n²)."""
        return sh.open_transfer(self._points.normals, self._order).astype(np.float32)

    def as_traced(self, traced: Traced, unseen: Mask) -> tuple[Array, Mask]:
        """As ``values``, without any fit."""
        at = np.flatnonzero(traced.point >= 0)
        row = np.full(self._parts.mesh.count, -1)
        row[traced.point[at]] = at
        values, hidden = traced.values.take(row, 0, mode="wrap"), unseen.take(row, mode="wrap")
        hidden &= row >= 0
        values[hidden | (row < 0)] = 0
        return values, hidden

    def keep_better(self, traced: Traced, shown: Array, has_points: Mask) -> None:
        """Of the parts whose points were all traced, ``has_points`` (count,), fit none any more
        where a fit predicts samples that it was not given far worse than what is ``shown`` (P, K)
        of the points alone does."""
        mine = traced[self.fitted[part_of(self._parts, traced)]]
        samples, _ = self._samples(mine)
        columns = self._order**2
        transfer = replace(samples, values=samples.values[:, :columns])
        self._judged = self._best_weights(transfer)
        missed = mine.values - interpolated(self._parts.mesh, mine.places, shown)
        of_points = self._mean_of_spare(samples, squares(missed[:, :columns]))
        tells = np.bincount(samples.parts, samples.spare, self._parts.count) > 0
        self.fitted &= ~(has_points & tells & (self._judged[1] > WORSE * of_points))

    def values(self, traced: Traced, unseen: Mask) -> tuple[Array, Array, Mask]:
        """Values (P, K), what of the transfer (P, n²) a second fit took, and the points that are
        buried, with values of 0."""
        parts = self._parts
        values, hidden = self.as_traced(traced, unseen)
        lost = np.zeros((len(values), self._order**2), np.float32)
        mine = self.fitted[part_of(parts, traced)]
        if mine.any():
            points = self.fitted[parts.of_points]
            found = self._fit(traced[mine & ~unseen])
            values[points], lost[points] = (each[points] for each in found)
            places = traced.places
            dark = buried_points(parts.mesh, places[mine & ~unseen], places[mine & unseen])
            hidden[points] = dark[points]
        values[hidden], lost[hidden] = 0, 0
        return values, lost, hidden

    def left_out(self, traced: Traced) -> Errors:
        """What a fit to ``traced`` misses where samples are left out, without their own noise."""
        samples, _ = self._samples(traced)
        transfer = replace(samples, values=samples.values[:, : self._order**2])
        _, missed = self._best_weights(transfer, TRIAL, ())
        nothing = np.zeros((self._parts.mesh.count, 1), np.float32)
        return self._errors(traced, samples, missed, nothing)

    def _best_weights(
        self,
        samples: Samples,
        weights: tuple[float, ...] = WEIGHTS,
        stiffer: tuple[float, ...] = STIFFER,
    ) -> tuple[Float, Float]:
        parts, threads = self._parts, self.threads
        of, count = parts.of_points, parts.count
        return best_weights(
            parts.mesh, samples, of, count, weights=weights, stiffer=stiffer, threads=threads
        )

    def _samples(self, traced: Traced) -> tuple[Samples, Array]:
        """What is fitted to, the deviation of ``traced`` from an open sky's transfer that is dimmed
        to what each part sees of it in the mean; and that transfer (P, n²)."""
        parts, columns = self._parts, self._order**2
        of, areas = part_of(parts, traced), self.areas(traced)
        open_here = interpolated(parts.mesh, traced.places, self._open)
        sums = [
            np.bincount(of, areas * np.einsum("sk,sk->s", values, open_here), parts.count)
            for values in (traced.values[:, :columns], open_here)
        ]
        gain = (sums[0] / np.maximum(sums[1], 1e-30)).astype(np.float32)
        deviation = traced.values.copy()
        deviation[:, :columns] -= gain[of][:, None] * open_here
        samples = Samples(traced.places, deviation, areas, of, traced.point < 0)
        return samples, gain[parts.of_points][:, None] * self._open

    def _fit(self, traced: Traced) -> tuple[Array, Array]:
        """Values (P, K) fitted to ``traced``, and what of the transfer the second fit took."""
        mesh, parts, columns = self._parts.mesh, self._parts, self._order**2
        samples, dimmed = self._samples(traced)
        transfer = replace(samples, values=samples.values[:, :columns])
        weights, missed = self._judged or self._best_weights(transfer)
        noise = traced.noisier * np.random.default_rng(0).standard_normal(len(samples.areas))
        columns_and_noise = [samples.values, noise[:, None].astype(np.float32)]
        samples = replace(samples, values=np.concatenate(columns_and_noise, axis=1))
        fit = Fit(mesh, parts.of_points, parts.count, self.threads)
        near = float(np.clip(NEAR * self._noise, *NEAREST))
        values, lost = fit.solve(samples, weights, columns, rough=1, tolerance=near)
        self.fit = fit if self._is_fitted_again else None
        self._fit_errors = self._errors(traced, samples, missed, values[:, -1:])
        values[:, :columns] += dimmed
        values[:, 0] = np.maximum(values[:, 0], 0)
        return values[:, :-1], lost

    def _errors(self, traced: Traced, samples: Samples, missed: Float, noise: Array) -> Errors:
        """What ``samples`` say of a fit: ``missed`` (count,) is the mean square of what it misses
        where samples were left out, ``noise`` (P, 1) what it makes of noise alone."""
        size = self._mean_of_spare(samples, squares(traced.values[:, : self._order**2]))
        noisier = self._mean_of_spare(samples, traced.noisier**2)
        of_places = self._noise**2 * size * noisier
        shown = interpolated(self._parts.mesh, traced.places, noise)
        of_noise = self._noise**2 * size * self._mean_of_spare(samples, squares(shown))
        return Errors(size, missed - of_places, of_noise)

    def _mean_of_spare(self, samples: Samples, values: npt.NDArray[Any]) -> Float:
        """The mean (count,) over each part of ``values`` (S,) of those that may be left out."""
        areas, count = np.where(samples.spare, samples.areas, 0), self._parts.count
        weight = np.maximum(np.bincount(samples.parts, areas, count), 1e-300)
        return np.asarray(np.bincount(samples.parts, areas * values, count) / weight)

    def areas(self, traced: Traced) -> Float:
        """The area (M,) that each place stands for."""
        parts, of = self._parts, part_of(self._parts, traced)
        density = np.ones(len(parts.mesh.corners))
        for triangles in parts.triangles():
            density[triangles] = parts.density(triangles)
        count = np.maximum(np.bincount(of, minlength=parts.count), 1)
        inside = (parts.surface.areas / density)[traced.places.triangles]
        at_points = (parts.point_areas() * parts.sizes()[parts.of_points])[traced.point]
        return np.where(traced.point < 0, inside, at_points) / count[of]

    def report(self, traced: Traced, unseen: Mask, values: Array) -> dict[str, Any]:
        """What the report says of ``values`` and of their errors, relative to the transfer."""
        is_inside = traced.point < 0
        inside, seen = traced[is_inside], ~unseen[is_inside]
        noisier = self._noisier(traced.point[~is_inside], traced.noisier[~is_inside])
        points = self._point_errors(inside[seen], values, noisier)
        of, count = part_of(self._parts, inside), self._parts.count
        looked = np.maximum(np.bincount(of, minlength=count), 1)
        areas = self._parts.areas() * np.bincount(of[seen], minlength=count) / looked

        def pooled(name: str) -> float:
            chosen = np.where(self.fitted, *(getattr(e, name) for e in (self._fit_errors, points)))
            return float((areas * chosen).sum())

        size = max(pooled("size"), 1e-300)
        of_noise = pooled("noise") / size
        surface = max(of_noise, pooled("surface") / size)
        fitted = self.fitted[self._parts.of_points]
        share = float(fitted.mean()) if len(fitted) else 0.0
        squared = float(np.mean(traced.noisier**2)) if len(traced.point) else 0.0
        return {
            "values": {"points": 1 - share, "fitted": share},
            "estimated_error": self._noise * squared**0.5,
            "interpolation_error": (surface - of_noise) ** 0.5,
            "surface_error": surface**0.5,
        }

    def _noisier(self, points: Index, noisier: Float) -> Float:
        """The mean square (count,) of how many times ``noisier`` (M,) each part's ``points`` (M,)
        are."""
        of, count = self._parts.of_points[points], self._parts.count
        found = np.bincount(of, noisier**2, count)
        return np.asarray(found / np.maximum(np.bincount(of, minlength=count), 1))

    def _point_errors(self, inside: Traced, values: Array, noisier: Float) -> Errors:
        """What places ``inside`` of the triangles say of ``values`` traced at their corners, where
        these are ``noisier`` (count,), squared."""
        parts, columns = self._parts, self._order**2
        transfer, of = inside.values[:, :columns], parts.of_triangles[inside.places.triangles]
        count = np.maximum(np.bincount(of, minlength=parts.count), 1)
        missed = transfer - interpolated(parts.mesh, inside.places, values[:, :columns])
        corners = np.square(inside.places.barycentric).sum(axis=1)
        both = inside.noisier**2 + noisier[of] * corners
        size = np.bincount(of, squares(transfer), parts.count) / count
        missed_squares = np.bincount(of, squares(missed), parts.count) / count
        expected = np.bincount(of, self._noise**2 * size[of] * both, parts.count) / count
        # the mean square of a place's coordinates is a half
        of_noise = self._noise**2 * size * noisier / 2
        return Errors(size, missed_squares - expected + of_noise, of_noise)


def squares(values: npt.NDArray[Any]) -> Float:
    """The mean square of each row."""
    return np.asarray(np.square(values, dtype=np.float64).mean(axis=1))
