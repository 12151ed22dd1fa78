"""Symmetric matrices over the points of a mesh, and what they take to a right side.

Points are numbered along a Z curve, so half of what a row holds lies near its diagonal: blocks of
that are dense, and their inverses precondition conjugate gradients (block Jacobi: Saad, Iterative
Methods for Sparse Linear Systems, 2003, 4.1), which then take half of the steps that they take with
the diagonal's.
"""

from collections.abc import Callable
from concurrent.futures import Executor
from dataclasses import dataclass

import numpy as np

from ..parallel import workers
from ..slices import slices, weighted_sums
from ..surface.points import Float, Index
from .fit_mesh import Array, Mesh, Quadratic

ANCHOR = 1e-6  # of the diagonal: holds what neither a sample nor an edge holds
SLACK = 1e-4  # of the diagonal, added before a block is inverted, which may hold itself no better
TOLERANCE = 3e-4  # of the norm of the right side, in the blocks' inverses
STEPS = 60
BLOCK = 32  # points
ROWS = 8192  # done together, whole blocks: of fewer ones threads wait for Python's lock
WIDTH = 4  # rows with about as many entries outside of their blocks are done together


class System:
    """A symmetric matrix over the points of a mesh with entries for the ends of each edge and the
    tips of each hinge."""

    def __init__(self, mesh: Mesh, threads: int = 0) -> None:
        self._threads, self._count = threads, mesh.count
        self._size = -(-mesh.count // BLOCK) * BLOCK
        pairs = np.concatenate([mesh.edges, mesh.hinges[:, 2:]])
        ends = np.concatenate([pairs, pairs[:, ::-1]])
        slab = (ends[:, 0] // ROWS).astype(np.uint16)  # which numpy sorts by radix
        order = np.argsort(slab, kind="stable")
        parts = slices(self._size, ROWS)
        found = np.split(order, np.searchsorted(slab[order], np.arange(1, len(parts))))
        self._slabs = [
            _Slab.of(ends[its], its % len(pairs), part, len(pairs))
            for its, part in zip(found, parts, strict=True)
        ]
        self._anchor = np.empty((0, 1), np.float32)

    def set(self, form: Quadratic, extra: Quadratic) -> None:
        """Make it the matrix of ``form`` plus ``extra``, with a little more on the diagonal."""
        diagonal = np.ones(self._size)
        diagonal[: self._count] = form.diagonal + extra.diagonal
        anchor = np.maximum(ANCHOR * diagonal, 1e-30)
        self._anchor, diagonal = anchor.astype(np.float32)[:, None], diagonal + anchor
        entries = np.concatenate([form.edges + extra.edges, form.tips + extra.tips, [0]])
        entries = entries.astype(np.float32)
        with self._pool() as pool:
            list(pool.map(lambda slab: slab.set(entries, diagonal), self._slabs))

    def solve(self, right: Array, guess: Array, tolerance: float | Float = TOLERANCE) -> Array:
        """The x (P, K) that this matrix takes to ``right`` plus the anchor at ``guess``; conjugate
        gradients, each column for itself to within its ``tolerance``."""
        with self._pool() as pool:
            x = self._padded(guess)
            steps = _Gradients(self._slabs, x, self._padded(right) + self._anchor * x, pool)
            energy = steps.start()
            for _ in range(STEPS):
                if (energy <= tolerance**2 * steps.size).all():
                    break
                energy = steps.go(energy)
        return x[: self._count]

    def _pool(self) -> Executor:
        return workers(self._threads, is_little=self._size <= ROWS)

    def _padded(self, values: Array) -> Array:
        """``values`` (P, K) in memory of their own, with rows of zeros up to whole blocks."""
        padded = np.zeros((self._size, values.shape[1]), np.float32)
        padded[: self._count] = values
        return padded


@dataclass(frozen=True)
class _Others:
    """What some of the ``rows`` (R,) of a slab hold outside of their blocks, as far as they have
    so much: the ``columns`` (R, W) of the matrix, the ``entries`` (R, W) there and their ``values``
    (R, W)."""

    rows: Index
    columns: Index
    entries: Index
    values: Array

    def add(self, x: Array, out: Array) -> None:
        """Add what these entries make of ``x`` (P, K) to the slab's rows ``out``."""
        out[self.rows] += weighted_sums(x, self.columns, self.values)


class _Slab:
    """Some ``rows`` of a matrix, whole blocks: these (B, BLOCK, BLOCK), out of the entries
    ``inside`` (I,) at the places ``flat`` (I,); about the inverse of each; and the others."""

    def __init__(self, rows: slice, inside: Index, flat: Index, others: list[_Others]) -> None:
        self.rows, self._inside, self._flat, self._others = rows, inside, flat, others
        self._blocks = self._inverse = np.empty((0, BLOCK, BLOCK), np.float32)

    @classmethod
    def of(cls, ends: Index, entries: Index, rows: slice, nothing: int) -> "_Slab":
        """Those ``rows`` that hold ``entries`` (E,) at the rows and columns ``ends`` (E, 2); the
        entry ``nothing`` is 0."""
        row, column = ends.T - rows.start
        is_inside = row // BLOCK == column // BLOCK
        flat = row[is_inside] * BLOCK + column[is_inside] % BLOCK
        row, column, its = (values[~is_inside] for values in (row, column, entries))
        order = np.argsort(row.astype(np.uint16), kind="stable")
        column, its = column[order] + rows.start, its[order]
        degree = np.bincount(row, minlength=rows.stop - rows.start)
        before, width = np.cumsum(degree) - degree, -(-degree // WIDTH) * WIDTH
        others = []
        for size in np.unique(width[width > 0]):
            chosen, k = np.flatnonzero(width == size), np.arange(size)
            has = k < degree[chosen, None]
            at = np.where(has, before[chosen, None] + k, 0)
            where, what = np.where(has, column[at], 0), np.where(has, its[at], nothing)
            others.append(_Others(chosen, where, what, np.zeros(at.shape, np.float32)))
        return cls(rows, entries[is_inside], flat, others)

    def set(self, entries: Array, diagonal: Float) -> None:
        """Put the values of all ``entries`` and of the ``diagonal`` into it."""
        its, step = diagonal[self.rows].reshape(-1, BLOCK), np.arange(BLOCK)
        size = its.size * BLOCK
        blocks = np.bincount(self._flat, entries.take(self._inside), size).astype(np.float32)
        self._blocks = blocks.reshape(-1, BLOCK, BLOCK)
        self._blocks[:, step, step] += its
        held = self._blocks.copy()
        held[:, step, step] += SLACK * its
        self._inverse = np.linalg.inv(held)
        for others in self._others:
            others.values[:] = entries.take(others.entries)

    def product(self, x: Array) -> Array:
        """These rows of the matrix times ``x`` (P, K)."""
        mine = x[self.rows]
        out = (self._blocks @ mine.reshape(-1, BLOCK, x.shape[1])).reshape(mine.shape)
        for others in self._others:
            others.add(x, out)
        return out

    def near(self, x: Array) -> Array:
        """What these rows of the matrix take to these of ``x`` (P, K), about."""
        mine = x[self.rows]
        return (self._inverse @ mine.reshape(-1, BLOCK, x.shape[1])).reshape(mine.shape)


class _Gradients:
    """Conjugate gradients for the ``slabs`` of a matrix from ``x`` (P, K), where it is to find what
    gives ``right`` (P, K): both are changed.

    Every step goes through the slabs in threads: a slab's arrays stay in the processor's cache, and
    its part of a sum is the same in any company.
    """

    def __init__(self, slabs: list[_Slab], x: Array, right: Array, pool: Executor) -> None:
        self._slabs, self._pool, self.x, self._residual = slabs, pool, x, right
        self._towards, self._image, self._near = np.empty((3, *right.shape), np.float32)
        self.size = np.zeros(right.shape[1])
        self._length: Array = np.zeros(right.shape[1], np.float32)
        self._keep = self._length

    def start(self) -> Float:
        """The energy (K,) of what is missing at first; ``size``, of all that is asked for."""
        self.size = self._sum(self._sizes)
        return self._sum(self._first)

    def go(self, energy: Float) -> Float:
        """One step; the energy that is then left."""
        self._length = ratio(energy, self._sum(self._curvature))
        left = self._sum(self._descend)
        self._keep = ratio(left, energy)
        self._sum(self._turn)
        return left

    def _sum(self, step: Callable[[_Slab], Float]) -> Float:
        return np.asarray(sum(self._pool.map(step, self._slabs), np.zeros(len(self.size))))

    def _sizes(self, slab: _Slab) -> Float:
        return _dot(self._residual[slab.rows], slab.near(self._residual))

    def _first(self, slab: _Slab) -> Float:
        self._residual[slab.rows] -= slab.product(self.x)
        self._towards[slab.rows] = slab.near(self._residual)
        return _dot(self._residual[slab.rows], self._towards[slab.rows])

    def _curvature(self, slab: _Slab) -> Float:
        self._image[slab.rows] = slab.product(self._towards)
        return _dot(self._towards[slab.rows], self._image[slab.rows])

    def _descend(self, slab: _Slab) -> Float:
        rows = slab.rows
        self.x[rows] += _times(self._towards[rows], self._length)
        self._residual[rows] -= _times(self._image[rows], self._length)
        self._near[rows] = slab.near(self._residual)
        return _dot(self._residual[rows], self._near[rows])

    def _turn(self, slab: _Slab) -> Float:
        rows = slab.rows
        self._towards[rows] = _times(self._towards[rows], self._keep) + self._near[rows]
        return np.zeros(len(self.size))


def _times(values: Array, factors: Array) -> Array:
    """The columns of ``values`` (R, K) times ``factors`` (K,); here and in ``_dot`` eight rows are
    worked on as one, which numpy does faster."""
    rows = values.reshape(-1, 8 * len(factors))
    return np.asarray(rows * np.tile(factors, 8)).reshape(values.shape)


def _dot(a: Array, b: Array) -> Float:
    """Products (K,) of the columns."""
    columns = a.shape[1]
    sums = (a * b).reshape(-1, 8 * columns).sum(axis=0).reshape(8, columns)
    return np.asarray(sums.sum(axis=0, dtype=np.float64))


def ratio(a: Float, b: Float) -> Array:
    """``a`` (K,) over ``b`` (K,), 0 where that is not positive."""
    return np.asarray(a / np.where(b > 0, b, 1) * (b > 0), np.float32)
