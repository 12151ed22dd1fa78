"""What the rays of some places meet, as it was recorded, and packed to be summed."""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from ..slices import cached_slices
from .shares import shares

Array = npt.NDArray[np.float32]
Index = npt.NDArray[np.int64]
Entry = npt.NDArray[np.int32]

PIECE = 1 << 10  # places of a chunk, which one thread sums
EVEN = 8  # a row's width is a multiple of it, so that its sum is the same bits in any company


@dataclass
class Packed:
    """What each of the places ``numbers`` (P,) meets, side by side: the ``entries`` (P, V) that
    rays end at, -1 after the last one, and the ``shares`` (P, V) of these, 0 there.  Of its row a
    place needs ``widths`` (P,)."""

    numbers: Index
    entries: Entry
    shares: Array
    widths: Index

    @classmethod
    def of(cls, numbers: Index, counts: Index, ends: Entry, its_shares: Array) -> "Packed":
        """Of the places ``numbers`` (P,), so many ``counts`` (P,) of whose rays meet something: the
        entries that these end at and their shares, one place after the other."""
        widths = -(-counts // EVEN) * EVEN
        width = int(widths.max(initial=0))
        starts = np.arange(len(counts)) * width
        places = np.arange(len(ends)) + np.repeat(starts - (np.cumsum(counts) - counts), counts)
        entries = np.full((len(counts), width), -1, np.int32)
        entries.reshape(-1)[places] = ends
        packed = np.zeros((len(counts), width), np.float32)
        packed.reshape(-1)[places] = its_shares
        return cls(numbers, entries, packed, widths)

    def translate(self, source_of: Entry) -> None:
        """Put the sources ``source_of`` (2 count + 1,) entries in their place; the last of them is
        that of the sky."""
        self.entries = source_of.take(self.entries)

    def means(self, table: Array) -> Array:
        """The means (P, K), over what each place meets, of the rows of ``table`` (S + 1, K), which
        are sources; nothing comes from the last one."""
        count, columns = len(self.numbers), table.shape[1]
        means = np.empty((count, 1, columns), np.float32)
        for some in cached_slices(count, self.entries.shape[1] * columns):
            width = int(self.widths[some].max())
            found = table.take(self.entries[some, :width], axis=0, mode="clip")
            np.matmul(self.shares[some, None, :width], found, out=means[some])
        return means[:, 0]


@dataclass(frozen=True)
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

    def packed(self) -> Packed:
        """Without the rays that reach the sky."""
        met = self.entries >= 0
        counts, its_shares = np.count_nonzero(met, axis=1), shares(met, self.local, self.others)
        rays = np.flatnonzero(met)
        return Packed.of(
            self.numbers,
            counts,
            self.entries.reshape(-1).take(rays),
            its_shares.reshape(-1).take(rays),
        )


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
