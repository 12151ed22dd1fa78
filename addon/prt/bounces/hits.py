"""What the rays of places meet, kept or found again, and sums over it.

Rays are cosine-distributed, so what a place receives from other surfaces is the mean over its rays
of what leaves the entries that they end at, and nothing where they reach the sky: a gather, with no
ray of its own.  How many rays meet something is known of all of them, so where only some are looked
at what these meet stands for the rest that meets something too.  An entry and its share take eight
bytes.
"""

import threading
from collections.abc import Callable, Generator, Iterator
from concurrent.futures import Future, wait
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
import numpy.typing as npt

from ..parallel import TICK, workers
from ..place_tape import RayEnds
from ..slices import slices
from ..tracing.confirm import NEARLY_DARK
from ..tracing.looking import Look, Shown
from ..tracing.rays import BLOCKED, Geometry, Mask, Met
from .chunks import PIECE, Chunk, Packed, joined
from .entries import Entries

Array = npt.NDArray[np.float32]
Index = npt.NDArray[np.int64]
Entry = npt.NDArray[np.int32]

LIMIT_BYTES = 2 << 30  # of what is kept in a run; beyond, rays are traced again for every bounce
JOINED = 8  # chunks of a trace, whose places are a piece or less
PROBE = 8  # of so many places one tells whether the others will be dark
MOSTLY = 0.25  # of places that are dark: so many are not worth casting twice
PLASTIC = 0.7548776662466927  # Roberts' R1: draws corners evenly over the rays of a place
GOLDEN = 0.6180339887498949


class Gathered(Protocol):
    """Sums over what the rays of some places meet."""

    @property
    def count(self) -> int:
        """How many places."""
        ...

    def entries(self) -> Iterator[tuple[Index, Entry]]:
        """Places (P,) and the entries (P, W) that their rays end at, as long as these are entries,
        -1 for the sky."""
        ...

    def gather(
        self, table: Array, source_of: Entry, hidden: Array, out: Array
    ) -> Generator[int, None, None]:
        """Fill ``out`` (M, K) with the mean over each place's rays, of which a share ``hidden``
        (M,) meets something, of the rows of ``table`` (S + 1, K) of the sources of their entries;
        yields the rays that this has cast."""
        ...


class Meeting:
    """Finds the entries that rays end at; safe to call from several threads."""

    def __init__(self, geometry: Callable[[], Geometry], entries: Entries, seed: int) -> None:
        self._geometry, self._entries, self._seed = geometry, entries, seed

    def __call__(self, shown: Shown) -> tuple[Mask, Chunk]:
        """As a Look is asked: the mask, and what was hit from places that hit anything."""
        rays, width = shown.rays, len(shown.rays)
        open_rays = int(rays[0]) // int(rays[1] - rays[0]) if width > 1 else 0
        met = self._met(open_rays, width, shown.origins, shown.directions)
        entries = np.full(len(met.triangles), -1, np.int32)
        blocked = np.flatnonzero(met.triangles >= 0)
        entries[blocked] = self._entries_of(met, blocked, shown)
        mask = np.minimum(entries, BLOCKED)  # -1 is CLEAR
        its = entries.reshape(-1, width)
        some = np.flatnonzero((its >= 0).any(axis=1))
        return mask, Chunk(shown.numbers[some], shown.others[some], its[some], shown.local)

    def _entries_of(self, met: Met, blocked: Index, shown: Shown) -> Entry:
        """The entries (B,) that the rays ``blocked`` (B,) of those ``shown`` end at."""
        its = Met(*(values.take(blocked, axis=0) for values in vars(met).values()))
        random = self._random(shown.numbers, shown.rays, blocked)
        entries = self._entries.drawn(its, random)
        product = its.facing * shown.directions.take(blocked, axis=0)
        is_back = product[:, 0] + product[:, 1] + product[:, 2] > 0
        entries += is_back * np.int32(self._entries.count)
        return entries

    def _met(self, first: int, width: int, origins: Array, directions: Array) -> Met:
        """What rays meet, ``width`` of each place, whose ``first`` ones are clear.

        At a place that sees next to no sky a ray that slipped between two triangles would bring
        light, so its rays are cast in the robust mode: after the fast one has shown it to be dark,
        or at once where most of the first places are.
        """
        geometry = self._geometry()
        if not geometry.lets_slip or not len(directions):
            return geometry.first_met(origins, directions)
        probe = width * -(-len(directions) // max(1, width * PROBE))
        begun, dark = self._checked(geometry, first, width, origins[:probe], directions[:probe])
        rest = origins[probe:], directions[probe:]
        if dark > MOSTLY:
            others = geometry.watertight().first_met(*rest)
        else:
            others, _ = self._checked(geometry, first, width, *rest)
        pairs = zip(vars(begun).values(), vars(others).values(), strict=True)
        return Met(*(np.concatenate(pair) for pair in pairs))

    @staticmethod
    def _checked(
        geometry: Geometry, first: int, width: int, origins: Array, directions: Array
    ) -> tuple[Met, float]:
        """What rays meet for certain, and the share of places that are dark."""
        met = geometry.first_met(origins, directions)
        clear = first + np.count_nonzero(met.triangles.reshape(-1, width) < 0, axis=1)
        dark = np.flatnonzero(clear <= NEARLY_DARK * (first + width))
        if len(dark):
            rays = (dark[:, None] * width + np.arange(width)).reshape(-1)
            certain = geometry.watertight().first_met(origins[rays], directions[rays])
            for name, values in vars(certain).items():
                getattr(met, name)[rays] = values
        return met, len(dark) / max(1, len(clear))

    def _random(self, numbers: Index, rays: Index, chosen: Index) -> Array:
        """What draws the corners for the ``chosen`` (B,) of ``rays`` (W,) of places ``numbers``
        (P,), one after the other, in [0, 1)."""
        shift = (numbers * GOLDEN + self._seed * PLASTIC) % 1
        every = shift.astype(np.float32)[:, None] + (rays * PLASTIC % 1).astype(np.float32)
        drawn = every.reshape(-1).take(chosen)
        drawn -= drawn >= 1
        return drawn


class Kept:
    """What rays of ``count`` places meet, in memory.  The ``chunks`` are packed beside what is done
    meanwhile, which does not keep all cores busy."""

    def __init__(self, count: int, threads: int, chunks: list[Chunk]) -> None:
        self._count, self._threads = count, threads
        beside = workers(1)
        self._packed = [beside.submit(chunk.packed) for chunk in chunks]
        beside.shutdown(wait=False)
        self._translated = False

    @property
    def count(self) -> int:
        """See Gathered."""
        return self._count

    def entries(self) -> Iterator[tuple[Index, Entry]]:
        """See Gathered."""
        return ((its.numbers, its.entries) for its in map(Future.result, self._packed))

    def gather(
        self, table: Array, source_of: Entry, hidden: Array, out: Array
    ) -> Generator[int, None, None]:
        """See Gathered.  The first time, sources take the place of the entries."""
        if not self._translated:
            yield from self._each(lambda its: its.translate(source_of))
            self._translated = True
        looked_at = np.zeros(self._count, bool)

        def mean(its: Packed) -> None:
            out[its.numbers], looked_at[its.numbers] = its.means(table), True

        yield from self._each(mean)
        _shade(out, looked_at, hidden)

    def _each(self, work: Callable[[Packed], None]) -> Iterator[int]:
        """Do ``work`` with all that is packed, whichever comes first."""
        with workers(self._threads) as pool:
            at_work = []
            for packed in self._packed:
                yield from _alive(packed)
                at_work.append(pool.submit(work, packed.result()))
            for future in at_work:
                yield from _alive(future)
                future.result()
        yield 0


def _alive(future: Future[Any]) -> Iterator[int]:
    """Yields 0 now and then until ``future`` is done."""
    while not wait([future], TICK).done:
        yield 0


class Again:
    """What is found again for each gather: ``trace`` traces ``count`` places once more, with the
    ``meeting`` that found it first, and yields the rays cast so far."""

    def __init__(
        self, count: int, trace: Callable[[Look], Generator[int, None, None]], meeting: Meeting
    ) -> None:
        self._count, self._trace, self._meeting = count, trace, meeting

    @property
    def count(self) -> int:
        """See Gathered."""
        return self._count

    def entries(self) -> Iterator[tuple[Index, Entry]]:
        """See Gathered."""
        found: list[Chunk] = []

        def look(shown: Shown) -> Mask:
            mask, chunk = self._meeting(shown)
            found.append(chunk)
            return mask

        for _ in self._trace(look):
            while found:
                chunk = found.pop()
                yield chunk.numbers, chunk.entries

    def gather(
        self, table: Array, source_of: Entry, hidden: Array, out: Array
    ) -> Generator[int, None, None]:
        """See Gathered."""
        looked_at = np.zeros(self._count, bool)

        def look(shown: Shown) -> Mask:
            mask, chunk = self._meeting(shown)
            its = chunk.packed()
            its.translate(source_of)
            out[its.numbers], looked_at[its.numbers] = its.means(table), True
            return mask

        yield from self._trace(look)
        _shade(out, looked_at, hidden)


def _shade(out: Array, looked_at: npt.NDArray[np.bool_], hidden: Array) -> None:
    """From the means ``out`` (M, K) over rays that meet something to those over all rays, of which
    a share ``hidden`` (M,) does.  A place of whose few such rays none was ``looked_at`` (M,) is
    taken to meet what the one before it does."""
    before = np.maximum.accumulate(np.where(looked_at, np.arange(len(out)), -1))
    none = np.flatnonzero(~looked_at)
    out[none] = np.where(before[none, None] >= 0, out[before[none]], 0)
    out *= hidden[:, None]


@dataclass(frozen=True)
class Leaving:
    """What leaves the entries that rays end at: the rows of ``table`` (S, K) of the sources
    ``source_of`` (2 count,) them, found by the ``meeting``."""

    meeting: Meeting
    table: Array
    source_of: Entry

    def look(self, rays: int, out: Array, ends: RayEnds) -> Look:
        """What puts the mean over the ``rays`` of each place that is traced into ``out`` (M, K),
        zeros, where all are shown: a final gather.  Where they end is kept among the ``ends``."""
        kind = np.min_scalar_type(len(self.source_of))

        def look(shown: Shown) -> Mask:
            mask, chunk = self.meeting(shown)
            met = chunk.entries >= 0
            counts, its = np.count_nonzero(met, axis=1), chunk.entries[met]
            ends.keep(chunk.numbers, counts, its.astype(kind))
            self._gather(chunk.numbers, counts, its, rays, out)
            return mask

        return look

    def recall(
        self, rays: int, out: Array, ends: RayEnds, threads: int
    ) -> Generator[None, None, None]:
        """As ``look``, for the places whose ``ends`` are known, which are not traced.  Yields now
        and then."""

        def gather(some: slice) -> None:
            numbers = ends.known[some]
            self._gather(numbers, *ends.of(numbers), rays, out)

        pool = workers(threads)
        try:
            yield from pool.map(gather, slices(len(ends.known), PIECE))
        finally:
            pool.shutdown(wait=True, cancel_futures=True)

    def _gather(self, numbers: Index, counts: Index, ends: Entry, rays: int, out: Array) -> None:
        """Put the mean over the ``rays`` of places ``numbers`` (P,), of which ``counts`` (P,) meet
        something, at the ``ends``, into ``out``."""
        equal = np.repeat(np.float32(1) / np.maximum(counts, 1).astype(np.float32), counts)
        its = Packed.of(numbers, counts, ends, equal)
        its.translate(self.source_of)
        hidden = counts.astype(np.float32) / rays
        out[numbers] = its.means(self.table) * hidden[:, None]


class Recorder:
    """Looks at the rays of ``count`` places and keeps what they meet, as long as ``budget`` holds
    it."""

    def __init__(self, meeting: Meeting, budget: "Budget") -> None:
        self._meeting, self._budget = meeting, budget
        self._chunks: list[Chunk] = []
        self._lock = threading.Lock()
        self._kept = True

    def __call__(self, shown: Shown) -> Mask:
        """See Look."""
        mask, chunk = self._meeting(shown)
        with self._lock:
            self._kept = self._kept and self._budget.take(chunk.bytes)
            if self._kept:
                self._chunks.append(chunk)
            else:
                self._budget.give_back(sum(c.bytes for c in self._chunks))
                self._chunks.clear()
        return mask

    def chunks(self) -> list[Chunk] | None:
        """All that was met, in the order of the places; None where it was too much."""
        if not self._kept:
            return None
        some = [chunk for chunk in self._chunks if len(chunk.numbers)]
        some.sort(key=lambda chunk: int(chunk.numbers[0]))
        return [joined(some[i : i + JOINED]) for i in range(0, len(some), JOINED)]

    def arrays(self) -> dict[str, npt.NDArray[Any]] | None:
        """All that was met as arrays named like the fields of a Chunk; None where it was too
        much."""
        chunks = self.chunks()
        return None if chunks is None else vars(joined(chunks))


class Budget:
    """Bytes that may still be kept."""

    def __init__(self, limit: int = LIMIT_BYTES) -> None:
        self._left = limit

    def take(self, size: int) -> bool:
        """Whether ``size`` bytes more may be kept."""
        enough = size <= self._left
        self._left -= size if enough else 0
        return enough

    def give_back(self, size: int) -> None:
        """What was taken is free again."""
        self._left += size
