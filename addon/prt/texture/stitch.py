"""The borders of charts: what is read there is made what was found, and to meet over seams.

A texel whose centre lies beyond a chart's border was traced at the border, so a read there, which
mixes it with its neighbours inside, comes out as if it lay a part of a texel further in: dark
corners are too light.  And the texels of both sides of a seam lie differently on the surface, so
that two such reads differ: a line that the eye follows.  A least-squares fit changes the texels
that are read along borders, most of all those outside, which hardly anything else reads, until
reads at the border find what was found there and those of both sides meet.
"""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from ..surface.samples import Places
from .cover import Float, Index, Layout
from .sampling import footprint

Array = npt.NDArray[np.float32]

BEYOND = 0.15  # texels: a centre that is further outside was traced at the border
FOUND = 1.0  # weight of a read at the border that misses what was found
LEAST_KEPT = 0.02  # weight of a change of a texel that hardly any place reads; of others 1
EVERY = 0.5  # texels between samples of a seam
MEET = 10.0  # weight of a difference across a seam
PIECE = 1 << 16  # texels that are looked at together
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

    def and_(self, other: "Samples", weight: float) -> "Samples":
        """Both, the ``other`` ones with ``weight`` relative to these."""
        return Samples(
            np.concatenate([self.rows, other.rows]),
            np.concatenate([self.weights, np.float32(weight) * other.weights]),
        )

    def read(self, values: Array) -> Array:
        """The products (S, K) of the weights and ``values`` (T, K): jumps across seams."""
        out = np.empty((len(self.rows), values.shape[1]), np.float32)
        for first in range(0, len(out), BLOCK):
            some = slice(first, first + BLOCK)
            np.einsum("sj,sjk->sk", self.weights[some], values[self.rows[some]], out=out[some])
        return out


class Stitch:
    """The system whose solution makes what ``samples`` read what is wanted; ``kept`` (T,) is the
    weight of a change of each texel."""

    def __init__(self, samples: Samples, kept_weights: Array) -> None:
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
        self._keep = kept_weights[kept].astype(np.float32)[:, None]
        self._diagonal = self._keep + squares.astype(np.float32)[:, None]

    def solve(self, values: Array, wanted: Array) -> None:
        """Change ``values`` (T, K) in place by dx, each column for itself, so that keep |dx|² +
        |read of x + dx - ``wanted`` (S, K)|² is least: by conjugate gradients."""
        residual = self._gathered(wanted - self._samples.read(values[self.rows]))
        x = np.zeros_like(residual)
        scaled = residual / self._diagonal
        towards, energy = scaled.copy(), _dot(residual, scaled)
        enough = TOLERANCE**2 * energy
        for _ in range(STEPS):
            if (energy <= enough).all():
                break
            image = self._keep * towards + self._gathered(self._samples.read(towards))
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


def borders(
    layout: Layout, index: Index, centres: Places, at: npt.NDArray[np.int32], found: Index
) -> tuple[Samples, Index, Float]:
    """The reads where texels of the rows ``found`` were traced whose own centres lie outside of the
    chart, the rows (B,) of these texels, and how far outside all lie (T,), in texels.  ``centres``
    are the places on the surface nearest to the centres of the texels ``index`` (T,)."""
    size, outside = layout.size, np.empty(len(index))
    place = np.empty((len(index), 2))
    for first in range(0, len(index), PIECE):
        some = slice(first, first + PIECE)
        corners = layout.corners[centres.triangles[some]]
        place[some] = np.einsum("pk,pkc->pc", centres.barycentric[some], corners)
        its = np.stack([index[some] % size, index[some] // size], axis=1)
        outside[some] = np.linalg.norm(place[some] - its, axis=1)
    outside[outside <= BEYOND] = 0
    mine = found[outside[found] > 0]
    texels, weights = footprint((place[mine] + 0.5) / size, size)
    rows = at.reshape(-1)[texels].astype(np.int64)
    both = np.concatenate([np.maximum(rows, 0), np.zeros_like(rows)], axis=1)
    shares = np.concatenate([np.where(rows >= 0, weights, 0), np.zeros_like(weights)], axis=1)
    return Samples(both, shares.astype(np.float32)), mine, outside


def stitch(values: Array, seams: Samples, border: Samples, own: Index, outside: Float) -> None:
    """Change ``values`` (T, K) in place: reads across ``seams`` meet, and those at the ``border``
    find the values that its texels ``own`` (B,), traced there, have now.  ``outside`` (T,) is how
    far the centre of each texel lies from the chart, in texels."""
    if not len(seams.rows) + len(border.rows):
        return
    keep = np.where(outside > 0, 0.5 * np.square(np.maximum(1 - outside, 0)), 1)
    both = Samples(seams.rows, np.float32(MEET**0.5) * seams.weights).and_(border, FOUND**0.5)
    nothing = np.zeros((len(seams.rows), values.shape[1]), np.float32)
    wanted = np.concatenate([nothing, np.float32(FOUND**0.5) * values[own]])
    Stitch(both, np.maximum(keep, LEAST_KEPT).astype(np.float32)).solve(values, wanted)
