"""Seams: the two sides of an edge that a chart's border cuts are brought together.

Both sides were traced from the same surface, but their texels lie differently on it, so what a
bilinear read finds on one side differs from the other by a part of a texel's step: enough for a
line that the eye follows.  A least-squares fit changes the texels that are read along seams as
little as it can while the reads meet; no other texel changes.
"""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from .cover import Float, Index
from .sampling import footprint

Array = npt.NDArray[np.float32]

EVERY = 0.5  # texels between samples of a seam
MEET = 10.0  # weight of a difference across the seam, of a change of a texel 1
STEPS, TOLERANCE = 100, 1e-4  # of the norm of the right side
BLOCK = 1 << 13  # samples of a product that stay in the processor's cache


@dataclass(frozen=True)
class Samples:
    """Places along the seams, as what is read there: ``rows`` (S, 8) of the texels, four of each
    side, with ``weights`` (S, 8) of which one side's are negative, so that their product with the
    texels is the jump across the seam."""

    rows: Index
    weights: Array

    @classmethod
    def of(cls, seams: Float, size: int, at: npt.NDArray[np.int32]) -> "Samples":
        """Every half texel along ``seams`` (E, 2 sides, 2 ends, 2), in texels; ``at`` (N, N) is the
        row of each texel, -1 where there is none: there nothing is compared."""
        lengths = np.linalg.norm(seams[:, :, 1] - seams[:, :, 0], axis=2).max(axis=1, initial=0)
        counts = np.ceil(lengths / EVERY).astype(np.int64) + 1
        of = np.repeat(np.arange(len(seams)), counts)
        number = np.arange(len(of)) - np.repeat(np.cumsum(counts) - counts, counts)
        along = number / np.maximum(counts[of] - 1, 1)
        rows, weights = [], []
        for side, sign in ((0, 1.0), (1, -1.0)):
            start, end = seams[of, side, 0], seams[of, side, 1]
            place = start + along[:, None] * (end - start)
            texels, shares = footprint((place + 0.5) / size, size)
            rows.append(at.reshape(-1)[texels].astype(np.int64))
            weights.append(sign * shares)
        both, shares = np.concatenate(rows, axis=1), np.concatenate(weights, axis=1)
        whole = ((both >= 0) | (np.abs(shares) < 1e-6)).all(axis=1)
        shares = np.where(both < 0, 0, shares)[whole]
        return cls(np.maximum(both[whole], 0), shares.astype(np.float32))

    def jumps(self, values: Array) -> Array:
        """The jumps (S, K) of ``values`` (T, K) across the seams."""
        out = np.empty((len(self.rows), values.shape[1]), np.float32)
        for first in range(0, len(out), BLOCK):
            some = slice(first, first + BLOCK)
            np.einsum("sj,sjk->sk", self.weights[some], values[self.rows[some]], out=out[some])
        return out


class Stitch:
    """The system whose solution brings the sides of ``samples`` together."""

    def __init__(self, samples: Samples) -> None:
        used = np.abs(samples.weights) > 0
        kept, compact = np.unique(samples.rows[used], return_inverse=True)
        rows = np.zeros(samples.rows.shape, np.int64)
        rows[used] = compact.reshape(-1)
        self.rows, self._samples = kept, Samples(rows, samples.weights)
        entries = np.flatnonzero(used.reshape(-1))
        of = rows.reshape(-1)[entries]
        degree = np.bincount(of, minlength=len(kept))
        self._order = np.argsort(-degree, kind="stable")  # texels of the most samples first
        rank = np.empty_like(self._order)
        rank[self._order] = np.arange(len(kept))
        by_rank = entries[np.argsort(rank[of], kind="stable")]
        starts = np.cumsum(degree[self._order]) - degree[self._order]
        filled = [int((degree > k).sum()) for k in range(int(degree.max(initial=0)))]
        slots = [by_rank[starts[:n] + k] for k, n in enumerate(filled)]
        self._slots = [(s // 8, samples.weights.reshape(-1)[s][:, None]) for s in slots]
        squares = np.bincount(of, samples.weights.reshape(-1)[entries] ** 2, len(kept))
        self._diagonal = (1 + MEET * squares).astype(np.float32)[:, None]

    def solve(self, values: Array) -> None:
        """Change ``values`` (T, K) in place: least |dx|² + MEET |jump of x + dx|², each column for
        itself, by conjugate gradients."""
        jumps = self._samples.jumps(values[self.rows])
        residual = -np.float32(MEET) * self._gathered(jumps)
        x = np.zeros_like(residual)
        scaled = residual / self._diagonal
        towards, energy = scaled.copy(), _dot(residual, scaled)
        enough = TOLERANCE**2 * energy
        for _ in range(STEPS):
            if (energy <= enough).all():
                break
            image = towards + np.float32(MEET) * self._gathered(self._samples.jumps(towards))
            length = _ratio(energy, _dot(towards, image))
            x += length * towards
            residual -= length * image
            scaled = residual / self._diagonal
            before, energy = energy, _dot(residual, scaled)
            towards *= _ratio(energy, before)
            towards += scaled
        values[self.rows] += x

    def _gathered(self, of_samples: Array) -> Array:
        """The transposed weights times ``of_samples`` (S, K)."""
        sums = np.zeros((len(self.rows), of_samples.shape[1]), np.float32)
        for samples, weights in self._slots:
            sums[: len(samples)] += weights * of_samples[samples]
        out = np.empty_like(sums)
        out[self._order] = sums
        return out


def _dot(a: Array, b: Array) -> Float:
    """Products (K,) of the columns."""
    return np.asarray((a * b).sum(axis=0, dtype=np.float64))


def _ratio(a: Float, b: Float) -> Array:
    return np.asarray(a / np.where(b > 0, b, 1) * (b > 0), np.float32)
