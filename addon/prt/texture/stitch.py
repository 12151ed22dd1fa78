"""The borders of charts and the edges inside: reads there find what was found, and meet over seams.

A texel whose centre lies beyond a chart's border was traced at the border, so a read there, which
mixes it with its neighbours inside, comes out as if it lay a part of a texel further in: dark
corners are too light.  And the texels of both sides of a seam lie differently on the surface, so
that two such reads differ: a line that the eye follows.  A least-squares fit changes the
texels that are read along borders, most of all those outside, which hardly anything else reads,
until reads at the border find what was found there and those of both sides meet.

And where a shadow or a fold changes what is found within a texel, the mean of its places is not
what comes nearest to them once it is read between its neighbours: another fit, before that one,
which then holds the reads there to what it made of them.
"""

from collections.abc import Generator, Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from ..parallel import in_thread
from ..slices import weighted_sums
from ..surface.samples import Places
from ..vertex.system import ratio
from .cover import Float, Index, Layout, Mask
from .refine import Size
from .sampling import footprint

Array = npt.NDArray[np.float32]

BEYOND = 0.15  # texels: a centre that is further outside was traced at the border
FOUND = 1.0  # weight of a read at the border that misses what was found
SURE = 0.01  # weight of a change of a texel where reads by far miss what was found
EVER = 2.0  # weight of any such change where the noise of what was found is not known
AS_READ = 1.0  # weight of such a read that a seam moves from what it had come to
LEAST_KEPT = 0.02  # weight of a change of a texel that hardly any place reads; of others 1
LEAST_SHARE = 1e-6  # of a read: a texel that has less takes no part in it
EVERY = 0.5  # texels between samples of a seam
MEET = 10.0  # weight of a difference across a seam
PIECE = 1 << 16  # places that are found together
STEPS, TOLERANCE = 100, 1e-3  # of the norm of the right side


@dataclass(frozen=True)
class Samples:
    """S reads, as what they mix: ``rows`` (S, J) of texels with ``weights`` (S, J); four of a read
    at a place, eight of a difference, where those of one of its two places are negative."""

    rows: Index
    weights: Array

    @classmethod
    def at(cls, places: Float, size: int, at: npt.NDArray[np.int32]) -> "Samples":
        """Reads at ``places`` (S, 2) in texels; ``at`` (N, N) is the row of each texel, -1 where
        there is none."""
        texels, weights = footprint((places + 0.5) / size, size)
        rows = at.reshape(-1)[texels].astype(np.int64)
        return cls(rows, np.where(np.abs(weights) < LEAST_SHARE, 0, weights).astype(np.float32))

    @classmethod
    def across(cls, seams: Float, size: int, at: npt.NDArray[np.int32]) -> "Samples":
        """Jumps across ``seams`` (E, 2 sides, 2 ends, 2), in texels, every half texel, where both
        sides read only texels that there are."""
        lengths = np.linalg.norm(seams[:, :, 1] - seams[:, :, 0], axis=2).max(axis=1, initial=0)
        counts = np.ceil(lengths / EVERY).astype(np.int64) + 1
        of = np.repeat(np.arange(len(seams)), counts)
        number = np.arange(len(of)) - np.repeat(np.cumsum(counts) - counts, counts)
        along = (number / np.maximum(counts[of] - 1, 1))[:, None]
        places = seams[of, :, 0] + along[:, None] * (seams[of, :, 1] - seams[of, :, 0])
        here, there = (cls.at(places[:, side], size, at) for side in range(2))
        rows = np.concatenate([here.rows, there.rows], axis=1)
        samples = cls(rows, np.concatenate([here.weights, -there.weights], axis=1))
        return samples[samples.whole()]

    def whole(self) -> Mask:
        """Which (S,) read only texels that there are."""
        return np.asarray(((self.rows >= 0) | (self.weights == 0)).all(axis=1))

    def meet(self, others: Sequence["Samples"], count: int) -> Mask:
        """Which (S,) read any of the ``count`` texels that ``others`` read."""
        used = np.zeros(count, bool)
        for other in others:
            used[other.rows[other.weights != 0]] = True
        return np.asarray((used[self.rows] & (self.weights != 0)).any(axis=1))

    def __getitem__(self, chosen: Mask) -> "Samples":
        return Samples(self.rows[chosen], self.weights[chosen])

    def read(self, values: Array) -> Array:
        """What is read (S, K) of ``values`` (T, K)."""
        return weighted_sums(values, self.rows, self.weights)


@dataclass(frozen=True)
class Wanted:
    """What ``samples`` are to read, ``values`` (S, K), and the ``weight`` of the square of what
    they miss."""

    samples: Samples
    values: Array
    weight: float

    @classmethod
    def at(cls, places: Float, values: Array, weight: float, at: npt.NDArray[np.int32]) -> "Wanted":
        """``values`` (S, K) at ``places`` (S, 2), in texels, where only texels are read that there
        are; ``at`` (N, N) as for ``Samples``."""
        samples = Samples.at(places, len(at), at)
        whole = samples.whole()
        return cls(samples[whole], values[whole], weight)


class Stitch:
    """The system whose solution makes reads find what is ``wanted``; ``kept`` (T,) is the weight of
    a change of each texel."""

    def __init__(self, wanted: Sequence[Wanted], kept: Array) -> None:
        weighted = [np.float32(w.weight**0.5) * w.samples.weights for w in wanted]
        used = [np.abs(weights) > 0 for weights in weighted]
        entries = [w.samples.rows[u] for w, u in zip(wanted, used, strict=True)]
        self.rows, of = np.unique(np.concatenate(entries), return_inverse=True)
        compact = np.split(of.reshape(-1), np.cumsum([len(rows) for rows in entries])[:-1])
        self._samples = []
        for weights, u, rows in zip(weighted, used, compact, strict=True):
            full = np.zeros(weights.shape, np.int64)
            full[u] = rows
            self._samples.append(Samples(full, weights))
        self._wanted = [np.float32(w.weight**0.5) * w.values for w in wanted]
        shares = np.concatenate([weights[u] for weights, u in zip(weighted, used, strict=True)])
        starts = np.cumsum([0, *(len(weights) for weights in weighted)])
        samples = [start + np.nonzero(u)[0] for start, u in zip(starts, used, strict=False)]
        self._set_slots(of.reshape(-1), np.concatenate(samples), shares)
        self._keep = kept[self.rows].astype(np.float32)[:, None]
        squares = np.bincount(of.reshape(-1), shares**2, len(self.rows))
        self._diagonal = self._keep + squares.astype(np.float32)[:, None]

    def _set_slots(self, of: Index, samples: Index, shares: Array) -> None:
        """For each texel ``of`` (M,) the ``samples`` (M,) that read it and their ``shares`` (M,):
        the first of each texel, the second, and so on, texels of the most samples first."""
        count = len(self.rows)
        degree = np.bincount(of, minlength=count)
        self._order = np.argsort(-degree, kind="stable")
        rank = np.empty_like(self._order)
        rank[self._order] = np.arange(count)
        by_rank = np.argsort(rank[of], kind="stable")
        first = np.cumsum(degree[self._order]) - degree[self._order]
        self._slots = []
        for k in range(int(degree.max(initial=0))):
            chosen = by_rank[first[: int((degree > k).sum())] + k]
            self._slots.append((samples[chosen], shares[chosen][:, None]))

    def solve(self, values: Array) -> Generator[None, None, None]:
        """Change ``values`` (T, K) in place by dx, each column for itself, so that keep |dx|² and
        what reads of x + dx miss, squared and weighted, are least together: by conjugate gradients.
        Yields after each step."""
        missed = np.concatenate(self._wanted) - self._read(values[self.rows])
        residual = self._gathered(missed)
        x = np.zeros_like(residual)
        scaled = residual / self._diagonal
        towards, energy = scaled.copy(), _dot(residual, scaled)
        enough = TOLERANCE**2 * energy
        for _ in range(STEPS):
            if (energy <= enough).all():
                break
            image = self._keep * towards + self._gathered(self._read(towards))
            length = ratio(energy, _dot(towards, image))
            x += length * towards
            residual -= length * image
            scaled = residual / self._diagonal
            before, energy = energy, _dot(residual, scaled)
            towards *= ratio(energy, before)
            towards += scaled
            yield
        values[self.rows] += x

    def _read(self, values: Array) -> Array:
        """What all samples read of ``values`` (R, K) of the texels that they use."""
        return np.concatenate([samples.read(values) for samples in self._samples])

    def _gathered(self, of_samples: Array) -> Array:
        """The transposed weights times ``of_samples`` (S, K)."""
        sums = np.zeros((len(self.rows), of_samples.shape[1]), np.float32)
        for samples, weights in self._slots:
            found = of_samples.take(samples, axis=0, mode="clip")
            found *= weights
            sums[: len(samples)] += found
        out = np.empty_like(sums)
        out[self._order] = sums
        return out


def _dot(a: Array, b: Array) -> Float:
    """Products (K,) of the columns."""
    return np.asarray((a * b).sum(axis=0, dtype=np.float64))


def outside(places: Float, index: Index, size: int) -> Float:
    """How far (T,) the centres of the texels ``index`` (T,) lie from the ``places`` (T, 2) of their
    charts that are nearest to them, in texels; 0 where that is next to nothing."""
    row, column = np.divmod(index, size)
    away = np.hypot(places[:, 0] - column, places[:, 1] - row)
    return np.asarray(np.where(away > BEYOND, away, 0.0))


def in_atlas(layout: Layout, places: Places) -> Float:
    """Where ``places`` (M,) lie in the atlas (M, 2), in texels."""
    found = np.empty((len(places), 2))
    for first in range(0, len(found), PIECE):
        some = places[first : first + PIECE]
        corners = layout.corners[some.triangles]
        np.einsum("pk,pkc->pc", some.barycentric, corners, out=found[first : first + PIECE])
    return found


def sharpen(
    values: Array, within: Wanted, smooth: int, size: Size, noise: float
) -> Generator[None, None, None]:
    """Change ``values`` (T, K) in place so that reads ``within`` texels come nearer to what they
    are to find: in the first ``smooth`` columns the nearer, the more they miss what was found
    beyond its ``noise``, relative as ``size`` of these says.  The noise of others is not known, and
    there no texel leaves the range of these and of what it was: the edge of a sun's shadow would
    have a bright line along it.  Yields now and then."""
    if not len(within.values):
        return
    sharp, its = values[:, smooth:], within.values[:, smooth:]
    low, high = sharp.copy(), sharp.copy()
    for rows, shares in zip(within.samples.rows.T, within.samples.weights.T, strict=True):
        read = np.flatnonzero(shares > 0)
        for k in range(its.shape[1]):
            np.minimum.at(low[:, k], rows[read], its[read, k])
            np.maximum.at(high[:, k], rows[read], its[read, k])
        yield
    missed = size((within.samples.read(values) - within.values)[:, :smooth])
    as_sure = _kept(missed, within.samples, noise, len(values))
    as_ever = np.full(len(values), EVER, np.float32)
    for columns, kept in ((slice(0, smooth), as_sure), (slice(smooth, None), as_ever)):
        mine = replace(within, values=within.values[:, columns])
        yield from _meet([mine], kept, values[:, columns])
    np.clip(sharp, low, high, out=sharp)


def _meet(wanted: Sequence[Wanted], kept: Array, values: Array) -> Generator[None, None, None]:
    """Solve the Stitch of ``wanted`` and ``kept`` for ``values``.  Yields now and then."""
    system = yield from in_thread(lambda: Stitch(wanted, kept))
    yield from system.solve(values)


def _kept(missed: Array, samples: Samples, noise: float, count: int) -> Array:
    """The weight of a change of each of ``count`` texels, where a read that misses weighs 1: the
    variance of what was found over that of what texels are to change by, which is what ``samples``
    (S,) have ``missed`` (S,) without their ``noise``."""
    squares, weights = np.zeros(count), np.zeros(count)
    for rows, shares in zip(samples.rows.T, samples.weights.T, strict=True):
        read = shares > 0
        squares += np.bincount(rows[read], np.square(shares * missed)[read], count)
        weights += np.bincount(rows[read], np.square(shares)[read], count)
    changed = squares / np.maximum(weights, 1e-30) - noise**2
    kept = noise**2 / np.maximum(changed, 1e-30)
    return np.asarray(np.clip(kept, SURE, 1 / SURE), np.float32)


def stitch(
    values: Array, seams: Samples, border: Wanted, within: Samples, away: Float
) -> Generator[None, None, None]:
    """Change ``values`` (T, K) in place: reads across ``seams`` meet, those at the ``border`` find
    what was found there, and those ``within`` texels find what they do now.  ``away`` (T,) is how
    far, in texels, the centre of each texel lies outside of its chart.  Yields now and then."""
    nothing = np.zeros((len(seams.rows), values.shape[1]), np.float32)
    wanted = [w for w in (Wanted(seams, nothing, MEET), border) if len(w.values)]
    if wanted:
        beside = within[within.meet([w.samples for w in wanted], len(values))]
        if len(beside.rows):
            wanted.append(Wanted(beside, beside.read(values), AS_READ))
        keep = np.where(away > 0, 0.5 * np.square(np.maximum(1 - away, 0)), 1)
        kept = np.maximum(keep, LEAST_KEPT).astype(np.float32)
        yield from _meet(wanted, kept, values)
