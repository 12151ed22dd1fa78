"""What the rays of places meet, kept or found again, and sums over it.

Rays are cosine-distributed, so what a place receives from other surfaces is the mean over its rays
of what leaves the entries that they end at, and nothing where they reach the sky: a gather, with no
ray of its own.  An entry takes four bytes.
"""

import threading
from collections.abc import Callable, Generator, Iterator
from concurrent.futures import wait
from dataclasses import dataclass
from itertools import pairwise
from typing import Any, Protocol

import numpy as np
import numpy.typing as npt

from ..parallel import workers
from ..tracing.confirm import NEARLY_DARK
from ..tracing.rays import BLOCKED, CLEAR, Geometry, Mask, Met
from ..tracing.transfer import Look
from .entries import Entries

Array = npt.NDArray[np.float32]
Index = npt.NDArray[np.int64]
Entry = npt.NDArray[np.int32]

LIMIT_BYTES = 2 << 30  # of what is kept in a run; beyond, rays are traced again for every bounce
GATHER = 1 << 15  # hits of a chunk, which one thread sums
CACHED = 1 << 16  # floats that are found before they are summed: they stay in the processor's cache
PROBE = 8  # of so many places one tells whether the others will be dark
MOSTLY = 0.25  # of places that are dark: so many are not worth casting twice
PLASTIC = 0.7548776662466927  # Roberts' R1: draws corners evenly over the rays of a place
GOLDEN = 0.6180339887498949


@dataclass
class Chunk:
    """The hits of places ``numbers`` (P,), as many as ``counts`` (P,) of each in a row, ending at
    ``entries`` (H,)."""

    numbers: Index
    counts: Entry
    entries: Entry

    def translate(self, source_of: Entry) -> None:
        """Put sources in the place of the entries."""
        self.entries = source_of.take(self.entries)

    def sums(self, table: Array, scale: float, out: Array) -> None:
        """Write ``scale`` times the sums of the rows of ``table`` (E, K) that each place meets into
        ``out`` (M, K)."""
        some = np.flatnonzero(self.counts)
        if not len(some):
            return
        ends = np.cumsum(self.counts[some], dtype=np.int64)
        starts, sums = ends - self.counts[some], np.empty((len(some), table.shape[1]), np.float32)
        for low, high in _blocks(ends, CACHED // table.shape[1]):
            first = starts[low]
            found = table.take(self.entries[first : ends[high - 1]], axis=0, mode="clip")
            np.add.reduceat(found, starts[low:high] - first, axis=0, out=sums[low:high])
        sums *= np.float32(scale)
        out[self.numbers[some]] = sums


class Gathered(Protocol):
    """Sums over what the rays of some places meet."""

    @property
    def count(self) -> int:
        """How many places."""
        ...

    def entries(self) -> Iterator[tuple[Index, Entry, Entry]]:
        """Places, their counts of hits and the hits' entries, as long as these are entries."""
        ...

    def gather(self, table: Array, source_of: Entry, out: Array) -> Generator[int, None, None]:
        """Fill ``out`` (M, K) with the mean over each place's rays of the rows of ``table`` (S, K)
        of the sources of their entries; yields the rays that this has cast."""
        ...


class Meeting:
    """Finds the entries that rays end at; safe to call from several threads."""

    def __init__(self, geometry: Callable[[], Geometry], entries: Entries, seed: int) -> None:
        self._geometry, self._entries, self._seed = geometry, entries, seed

    def __call__(
        self, numbers: Index, first: int, origins: Array, directions: Array
    ) -> tuple[Mask, Chunk]:
        """As a Look is asked: the mask, and what was hit."""
        width = len(directions) // max(1, len(numbers))
        met = self._met(first, width, origins, directions)
        blocked = met.triangles >= 0
        hit = np.flatnonzero(blocked)
        random = self._random(numbers, np.arange(first, first + width))
        entries = self._entries.drawn(
            met.triangles.take(hit), met.u.take(hit), met.v.take(hit), random.take(hit)
        )
        along = np.einsum("rc,rc->r", met.facing, directions)
        entries += (along > 0).take(hit) * np.int32(self._entries.count)
        counts = np.count_nonzero(blocked.reshape(len(numbers), width), axis=1).astype(np.int32)
        mask = np.where(blocked, np.int32(BLOCKED), np.int32(CLEAR))
        return mask, Chunk(np.array(numbers), counts, entries)

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

    def _random(self, numbers: Index, rays: Index) -> Array:
        """What draws the corners for ``rays`` (W,) of places ``numbers`` (P,), one after the other,
        in [0, 1)."""
        shift = (numbers * GOLDEN + self._seed * PLASTIC) % 1
        drawn = shift.astype(np.float32)[:, None] + (rays * PLASTIC % 1).astype(np.float32)
        drawn -= drawn >= 1
        return np.asarray(drawn.reshape(-1))


class Kept:
    """Hits of ``count`` places with ``rays`` each, in memory."""

    def __init__(self, count: int, rays: int, threads: int, chunks: list[Chunk]) -> None:
        self._count, self._rays, self._threads, self._chunks = count, rays, threads, chunks
        self._translated = False

    @property
    def count(self) -> int:
        """See Gathered."""
        return self._count

    def entries(self) -> Iterator[tuple[Index, Entry, Entry]]:
        """See Gathered."""
        return ((chunk.numbers, chunk.counts, chunk.entries) for chunk in self._chunks)

    def gather(self, table: Array, source_of: Entry, out: Array) -> Generator[int, None, None]:
        """See Gathered.  The first time, sources take the place of the entries."""
        if not self._translated:
            yield from self._each(lambda chunk: chunk.translate(source_of))
            self._translated = True
        out[:] = 0
        yield from self._each(lambda chunk: chunk.sums(table, 1 / self._rays, out))

    def _each(self, work: Callable[[Chunk], None]) -> Iterator[int]:
        """Do ``work`` with every chunk, whichever comes first."""
        with workers(self._threads) as pool:
            for future in [pool.submit(work, chunk) for chunk in self._chunks]:
                while not wait([future], timeout=0.5).done:
                    yield 0
                future.result()
        yield 0


class Again:
    """Hits that are found again for each gather: ``trace`` traces ``count`` places once more, with
    the ``meeting`` that found them first, and yields the rays cast so far."""

    def __init__(
        self,
        count: int,
        rays: int,
        trace: Callable[[Look], Generator[int, None, None]],
        meeting: Meeting,
    ) -> None:
        self._count, self._rays, self._trace, self._meeting = count, rays, trace, meeting

    @property
    def count(self) -> int:
        """See Gathered."""
        return self._count

    def entries(self) -> Iterator[tuple[Index, Entry, Entry]]:
        """See Gathered."""
        found: list[Chunk] = []

        def look(numbers: Index, first: int, origins: Array, directions: Array) -> Mask:
            mask, chunk = self._meeting(numbers, first, origins, directions)
            found.append(chunk)
            return mask

        for _ in self._trace(look):
            while found:
                chunk = found.pop()
                yield chunk.numbers, chunk.counts, chunk.entries

    def gather(self, table: Array, source_of: Entry, out: Array) -> Generator[int, None, None]:
        """See Gathered."""
        out[:] = 0
        yield from self._trace(Leaving(self._meeting, table, source_of).look(self._rays, out))


@dataclass(frozen=True)
class Leaving:
    """What leaves the entries that rays end at: the rows of ``table`` (S, K) of the sources
    ``source_of`` (2 count,) them, found by the ``meeting``."""

    meeting: Meeting
    table: Array
    source_of: Entry

    def look(self, rays: int, out: Array) -> Look:
        """What adds the mean over the ``rays`` of each place that is traced to ``out`` (M, K),
        zeros: a final gather."""

        def look(numbers: Index, first: int, origins: Array, directions: Array) -> Mask:
            mask, chunk = self.meeting(numbers, first, origins, directions)
            chunk.translate(self.source_of)
            chunk.sums(self.table, 1 / rays, out)
            return mask

        return look


class Recorder:
    """Looks at the rays of ``count`` places and keeps what they meet, as long as ``budget`` holds
    it."""

    def __init__(self, meeting: Meeting, budget: "Budget") -> None:
        self._meeting, self._budget = meeting, budget
        self._chunks: list[Chunk] = []
        self._lock = threading.Lock()
        self._kept = True

    def __call__(self, numbers: Index, first: int, origins: Array, directions: Array) -> Mask:
        """See Look."""
        mask, chunk = self._meeting(numbers, first, origins, directions)
        with self._lock:
            self._kept = self._kept and self._budget.take(chunk.entries.nbytes)
            if self._kept:
                self._chunks.append(chunk)
            else:
                self._budget.give_back(sum(c.entries.nbytes for c in self._chunks))
                self._chunks.clear()
        return mask

    def chunks(self) -> list[Chunk] | None:
        """All that was met, in the order of the places; None where it was too much."""
        if not self._kept:
            return None
        return sorted(self._chunks, key=lambda chunk: int(chunk.numbers[0]))

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


def split(hits: Chunk) -> list[Chunk]:
    """``hits`` in chunks of about GATHER."""
    ends = np.cumsum(hits.counts, dtype=np.int64)
    chunks = []
    for low, high in _blocks(ends, GATHER):
        before = int(ends[low - 1]) if low else 0
        rows, its = slice(low, high), slice(before, int(ends[high - 1]))
        chunks.append(Chunk(hits.numbers[rows], hits.counts[rows], hits.entries[its]))
    return chunks


def _blocks(ends: Index, size: int) -> Iterator[tuple[int, int]]:
    """Parts of rows, whose hits end at ``ends`` (P,), with about ``size`` hits each."""
    total = int(ends[-1]) if len(ends) else 0
    cuts = np.searchsorted(ends, np.arange(size, total, size)) + 1
    return pairwise(np.unique(np.concatenate([[0], cuts, [len(ends)]])).tolist())


def joined(chunks: list[Chunk]) -> Chunk:
    """All of ``chunks`` as one."""
    none = np.empty(0, np.int32)
    return Chunk(
        np.concatenate([np.empty(0, np.int64), *(chunk.numbers for chunk in chunks)]),
        np.concatenate([none, *(chunk.counts for chunk in chunks)]),
        np.concatenate([none, *(chunk.entries for chunk in chunks)]),
    )
