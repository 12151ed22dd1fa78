"""Which texels take rays, and values between them.

From coarse to fine: every eighth texel is traced, then those half way between are interpolated or,
where what lies about them bends or differs too much, traced, and so on down to every texel.  A
texel whose neighbours do not all lie on the same smooth piece of a chart, or of which some are
buried, is traced; where all are buried, a look tells whether it is too.

A texel of the coarsest grid decides the values of many others and one of the finest only its own,
so the coarser grids take twice the rays.  Where the finest texels' neighbours differ too much there
is an edge between them, and the rays start from several places of a texel.
"""

from collections.abc import Generator
from dataclasses import dataclass
from typing import Protocol

import numpy as np
import numpy.typing as npt

from .cover import Index, Mask

Array = npt.NDArray[np.float32]

COARSEST = 8  # texels from one that is traced to the next
SHARES = {8: 2.0, 4: 2.0, 2: 1.0, 1: 0.75}  # of the rays, by the distance to the next texel
BEND = 8.0  # times the tolerance: half way on a parabola the error is an eighth of the bend
SPREAD = 8.0  # times the tolerance: neighbours that differ by more may have an edge between them
ENOUGH = 256  # texels that tell how large an object's values are
PIECE = 1 << 16  # texels that are looked at together

NONE = np.zeros(0, np.int64)
UNKNOWN, TRACED, BETWEEN, BURIED = range(4)


class Trace(Protocol):
    """Traces texels; ``cast`` is the rays so far."""

    cast: int

    def texels(
        self, rows: Index, share: float, sharp: Mask
    ) -> Generator[int, None, tuple[Array, Mask]]:
        """Yields the rays cast so far; the values (M, K) of the texels ``rows`` (M,), with
        ``share`` of the rays, those ``sharp`` (M,) from several places; and which are buried."""
        ...

    def are_buried(self, rows: Index) -> Generator[int, None, Mask]:
        """Yields the rays cast so far; which of the texels ``rows`` (M,) are buried."""
        ...


class Size(Protocol):
    """How large differences of values look."""

    def __call__(self, differences: Array) -> Array:
        """Of ``differences`` (M, K), relative to the RMS of the object: (M,)."""
        ...


@dataclass(frozen=True)
class Grid:
    """T texels of an atlas of ``size``²: their flat ``index`` (T,) in rising order, the smooth
    piece ``region`` (T,) that each is in, and the row ``at`` (N, N) int32 of each texel of the
    atlas, -1 where there is none."""

    size: int
    index: Index
    region: Index
    at: npt.NDArray[np.int32]

    @classmethod
    def of(cls, size: int, index: Index, region: Index) -> "Grid":
        """Of the texels ``index`` (T,)."""
        at = np.full(size * size, -1, np.int32)
        at[index] = np.arange(len(index), dtype=np.int32)
        return cls(size, index, region, at.reshape(size, size))

    def neighbours(self, rows: Index, steps: list[tuple[int, int]]) -> Index:
        """The rows (M, S) of the texels that lie ``steps`` (along r, along c) from those of
        ``rows`` (M,), -1 where none does on the same smooth piece."""
        row, column = np.divmod(self.index[rows], self.size)
        found = np.empty((len(rows), len(steps)), np.int64)
        for k, (up, right) in enumerate(steps):
            r, c = row + up, column + right
            inside = (r >= 0) & (c >= 0) & (r < self.size) & (c < self.size)
            near = self.at[np.clip(r, 0, self.size - 1), np.clip(c, 0, self.size - 1)]
            same = inside & (near >= 0) & (self.region[near] == self.region[rows])
            found[:, k] = np.where(same, near, -1)
        return found


class Refinement:
    """Fills ``values`` (T, K) of the texels of ``grid``; ``state`` (T,) says how each was found."""

    def __init__(self, grid: Grid, trace: Trace) -> None:
        self._grid, self._trace = grid, trace
        self.values = np.zeros((len(grid.index), 0), np.float32)
        self.state = np.full(len(grid.index), UNKNOWN, np.uint8)

    def start(self) -> Generator[int, None, None]:
        """Trace the coarsest grid, and of small charts so many that they tell the object's size."""
        row, column = np.divmod(self._grid.index, self._grid.size)
        is_first = (row % COARSEST == 0) & (column % COARSEST == 0)
        is_first[:: max(1, len(row) // ENOUGH)] |= is_first.sum() < ENOUGH
        rows = np.flatnonzero(is_first)
        values, buried = yield from self._trace.texels(
            rows, SHARES[COARSEST], is_first[rows] & False
        )
        self.values = np.zeros((len(row), values.shape[1]), np.float32)
        self._set(rows, values, buried)

    def go_on(self, size: Size, tolerance: float) -> Generator[int, None, None]:
        """Trace or interpolate all others; differences of ``tolerance`` don't matter."""
        row, column = np.divmod(self._grid.index, self._grid.size)
        step = COARSEST // 2
        while step:
            odd_row, odd_column = row % (2 * step) == step, column % (2 * step) == step
            on_row, on_column = row % (2 * step) == 0, column % (2 * step) == 0
            for mine, ways in (
                (on_row & odd_column, [(0, step)]),
                (odd_row & on_column, [(step, 0)]),
                (odd_row & odd_column, [(0, step), (step, 0)]),
            ):
                left = np.flatnonzero(mine & (self.state == UNKNOWN))
                yield from self._between(left, ways, size, tolerance)
            step //= 2

    def _between(
        self, rows: Index, ways: list[tuple[int, int]], size: Size, tolerance: float
    ) -> Generator[int, None, None]:
        """The texels ``rows`` half way between others, which lie along ``ways``."""
        needed, hidden, sharp = [NONE], [NONE], np.zeros(len(self.state), bool)
        for first in range(0, len(rows), PIECE):
            some = rows[first : first + PIECE]
            needs, differs, in_dark = np.zeros((3, len(some)), bool)
            in_dark[:] = True
            sums = np.zeros((len(some), self.values.shape[1]), np.float32)
            for up, right in ways:
                near = self._grid.neighbours(some, [(up * k, right * k) for k in (-1, 1, -3, 3)])
                sums += self._along(near, needs, differs, size, tolerance)
                in_dark &= ((near < 0) | (self.state[near] == BURIED))[:, :2].all(axis=1)
                in_dark &= (near >= 0)[:, :2].any(axis=1)
            calm = some[~needs]
            self.values[calm] = sums[~needs] / len(ways)
            self.state[calm] = BETWEEN
            sharp[some[differs]] = True
            needed.append(some[needs & ~in_dark])
            hidden.append(some[in_dark])
            yield self._trace.cast
        yield from self._look(np.concatenate(hidden), needed)
        rows, step = np.concatenate(needed), max(ways[0])
        if len(rows):
            several = sharp[rows] & (step == 1)
            self._set(rows, *(yield from self._trace.texels(rows, SHARES[step], several)))

    def _look(self, rows: Index, needed: list[Index]) -> Generator[int, None, None]:
        """Which of ``rows``, among buried texels, are so too; the others are ``needed``."""
        hidden = yield from self._trace.are_buried(rows)
        self.state[rows[hidden]] = BURIED
        needed.append(rows[~hidden])

    def _along(
        self, near: Index, needs: Mask, differs: Mask, size: Size, tolerance: float
    ) -> Array:
        """The mean (M, K) of the first two of each row of ``near`` (M, 4), and into ``needs`` where
        it can't be trusted, into ``differs`` where that is because these two differ too much."""
        known = (near >= 0) & np.isin(self.state[near], (TRACED, BETWEEN))
        left, right, before, after = (self.values[near[:, k]] for k in range(4))
        bends = np.where(known[:, 2], size(before - 2 * left + right), 0)
        bends = np.maximum(bends, np.where(known[:, 3], size(after - 2 * right + left), 0))
        bent = bends > BEND * tolerance
        differ = size(right - left) > SPREAD * tolerance
        has_both = known[:, :2].all(axis=1)
        differs |= has_both & differ & (bent | ~known[:, 2:].any(axis=1))
        needs |= ~has_both | bent | differs
        return (left + right) * np.float32(0.5)

    def _set(self, rows: Index, values: Array, buried: Mask) -> None:
        self.values[rows] = values
        self.state[rows] = np.where(buried, BURIED, TRACED)
