"""What the rays of places meet, kept or found again, and sums over it.

Rays are cosine-distributed, so what a place receives from other surfaces is the mean over its rays
of what leaves the entries that they end at, and nothing where they reach the sky: a gather, with no
ray of its own.  How many rays meet something is known of all of them, so where only some are looked
at what these meet stands for the rest that meets something too.  An entry and its share take eight
bytes.
"""

import threading
from collections.abc import Callable, Generator, Iterator
from concurrent.futures import wait
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
import numpy.typing as npt

from ..parallel import workers
from ..tracing.confirm import NEARLY_DARK
from ..tracing.looking import Look, Shown
from ..tracing.rays import BLOCKED, CLEAR, Geometry, Mask, Met
from .entries import Entries
from .shares import shares

Array = npt.NDArray[np.float32]
Index = npt.NDArray[np.int64]
Entry = npt.NDArray[np.int32]

LIMIT_BYTES = 2 << 30  # of what is kept in a run; beyond, rays are traced again for every bounce
PIECE = 1 << 10  # places of a chunk, which one thread sums
JOINED = 8  # chunks of a trace, whose places are a piece or less
CACHED = 1 << 18  # floats that are found before they are summed: they stay in the processor's cache
PROBE = 8  # of so many places one tells whether the others will be dark
MOSTLY = 0.25  # of places that are dark: so many are not worth casting twice
PLASTIC = 0.7548776662466927  # Roberts' R1: draws corners evenly over the rays of a place
GOLDEN = 0.6180339887498949


@dataclass
class Chunk:
    """What rays along ``local`` (W, 3) of the places ``numbers`` (P,) meet, all of which meet
    something: the ``entries`` (P, W) that they end at, -1 where they reach the sky; and of the
    ``others`` (P, 4), that nobody looked at, what ``shares`` asks for."""

    numbers: Index
    others: Array
    entries: Entry
    local: Array

    @property
    def bytes(self) -> int:
        """What it takes in memory, its shares included."""
        return 2 * self.entries.nbytes

    def translate(self, source_of: Entry) -> None:
        """Put the sources ``source_of`` (2 count + 1,) entries in their place; the last of them is
        that of the sky."""
        self._shares = shares(self.entries >= 0, self.local, self.others)
        self.entries = source_of.take(self.entries)

    def means(self, table: Array) -> Array:
        """The means (P, K), over what each place meets, of the rows of ``table`` (S + 1, K), which
        are sources; nothing comes from the last one."""
        width, columns = self.entries.shape[1], table.shape[1]
        means = np.empty((len(self.numbers), 1, columns), np.float32)
        rows = max(1, CACHED // max(1, width * columns))
        for some in (slice(low, low + rows) for low in range(0, len(means), rows)):
            found = table.take(self.entries[some], axis=0, mode="clip")
            np.matmul(self._shares[some, None], found, out=means[some])
        return means[:, 0]


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
        entries = self._entries.drawn(met, self._random(shown.numbers, rays))
        product = met.facing * shown.directions
        is_back = product[:, 0] + product[:, 1] + product[:, 2] > 0
        entries += is_back * np.int32(self._entries.count)
        blocked = met.triangles >= 0
        entries[~blocked] = -1
        some = np.flatnonzero(blocked.reshape(-1, width).any(axis=1))
        its = entries.reshape(-1, width)[some]
        mask = np.where(blocked, np.int32(BLOCKED), np.int32(CLEAR))
        return mask, Chunk(shown.numbers[some], shown.others[some], its, shown.local)

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
    """What rays of ``count`` places meet, in memory."""

    def __init__(self, count: int, threads: int, chunks: list[Chunk]) -> None:
        self._count, self._threads, self._chunks = count, threads, chunks
        self._translated = False

    @property
    def count(self) -> int:
        """See Gathered."""
        return self._count

    def entries(self) -> Iterator[tuple[Index, Entry]]:
        """See Gathered."""
        return ((chunk.numbers, chunk.entries) for chunk in self._chunks)

    def gather(
        self, table: Array, source_of: Entry, hidden: Array, out: Array
    ) -> Generator[int, None, None]:
        """See Gathered.  The first time, sources take the place of the entries."""
        if not self._translated:
            yield from self._each(lambda chunk: chunk.translate(source_of))
            self._translated = True
        looked_at = np.zeros(self._count, bool)

        def mean(chunk: Chunk) -> None:
            out[chunk.numbers], looked_at[chunk.numbers] = chunk.means(table), True

        yield from self._each(mean)
        _shade(out, looked_at, hidden)

    def _each(self, work: Callable[[Chunk], None]) -> Iterator[int]:
        """Do ``work`` with every chunk, whichever comes first."""
        with workers(self._threads) as pool:
            for future in [pool.submit(work, chunk) for chunk in self._chunks]:
                while not wait([future], timeout=0.5).done:
                    yield 0
                future.result()
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
            chunk.translate(source_of)
            out[chunk.numbers], looked_at[chunk.numbers] = chunk.means(table), True
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

    def look(self, rays: int, out: Array) -> Look:
        """What puts the mean over the ``rays`` of each place that is traced into ``out`` (M, K),
        zeros, where all are shown: a final gather."""

        def look(shown: Shown) -> Mask:
            mask, chunk = self.meeting(shown)
            hidden = np.count_nonzero(chunk.entries >= 0, axis=1).astype(np.float32) / rays
            chunk.translate(self.source_of)
            out[chunk.numbers] = chunk.means(self.table) * hidden[:, None]
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


def split(hits: Chunk) -> list[Chunk]:
    """``hits`` in chunks of PIECE places."""
    parts = (slice(i, i + PIECE) for i in range(0, len(hits.numbers), PIECE))
    return [Chunk(hits.numbers[p], hits.others[p], hits.entries[p], hits.local) for p in parts]


def joined(chunks: list[Chunk]) -> Chunk:
    """All of ``chunks`` as one.  Of the narrower ones the first rays are known to be open."""
    local = max((chunk.local for chunk in chunks), key=len, default=np.empty((0, 3), np.float32))
    numbers = np.concatenate([np.empty(0, np.int64), *(chunk.numbers for chunk in chunks)])
    others = np.concatenate([np.empty((0, 4), np.float32), *(chunk.others for chunk in chunks)])
    entries, before = np.full((len(numbers), len(local)), -1, np.int32), 0
    for its in (chunk.entries for chunk in chunks):
        entries[before : before + len(its), len(local) - its.shape[1] :] = its
        before += len(its)
    return Chunk(numbers, others, entries, local)
