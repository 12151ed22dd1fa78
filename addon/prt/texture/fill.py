"""Texels that nothing was found for: buried ones, and the rest of an atlas, which no surface reads
but a filter may."""

from collections.abc import Generator
from typing import Any

import numpy as np
import numpy.typing as npt

from .refine import Grid

Array = npt.NDArray[np.float32]
Mask = npt.NDArray[np.bool_]

AROUND = [(up, right) for up in (-1, 0, 1) for right in (-1, 0, 1) if up or right]


def push_pull(image: Array, known: Mask) -> Generator[None, None, None]:
    """Fill the texels of ``image`` (N, N, K) that are not ``known`` (N, N), in place, smoothly from
    those that are: each from the finest halving of the image in which something is known nearby.

    Known texels stay as they are.  An image in which nothing is known becomes 0.  Yields after each
    column.
    """
    if not known.any():
        image[:] = 0
        return
    masks = [known]
    while masks[-1].shape[0] > 1:
        masks.append(_sums(masks[-1]))
    for k in range(image.shape[2]):
        column = np.ascontiguousarray(image[:, :, k])
        _fill(column, masks)
        image[:, :, k] = column
        yield


def _fill(image: Array, masks: list[Mask]) -> None:
    """Fill ``image`` (N, N) where the first of ``masks`` is not set; the others halve it."""
    image[~masks[0]] = 0
    levels = [image]
    for mask in masks[:-1]:
        counts, sums = _sums(mask.astype(np.float32)), _sums(levels[-1])
        levels.append(np.asarray(sums / np.maximum(counts, 1), np.float32))
    for k in range(len(levels) - 2, -1, -1):
        unknown = ~masks[k]
        rows, columns = np.nonzero(unknown)
        levels[k][rows, columns] = _upsampled(levels[k + 1], rows, columns)


def _sums(values: npt.NDArray[Any]) -> npt.NDArray[Any]:
    """The sums (M, M) of squares of 2 x 2 of ``values`` (N, N), or which of them have any, with a
    row and a column of zeros more where N is odd."""
    if len(values) % 2:
        values = np.pad(values, (0, 1))
    rows = values[::2] + values[1::2]
    return np.asarray(rows[:, ::2] + rows[:, 1::2])


def _upsampled(coarse: Array, rows: npt.NDArray[np.int64], columns: npt.NDArray[np.int64]) -> Array:
    """What a bilinear read of ``coarse``, a halving, finds at the centres of the finer texels
    (S,)."""
    last = len(coarse) - 1

    def near(at: npt.NDArray[np.int64]) -> tuple[npt.NDArray[np.int64], npt.NDArray[np.int64]]:
        own = at // 2
        return own, np.clip(own + np.where(at % 2, 1, -1), 0, last)

    (row, other_row), (column, other_column) = near(rows), near(columns)
    mixed = np.float32(0.75) * coarse[row, column] + np.float32(0.25) * coarse[row, other_column]
    other = np.float32(0.75) * coarse[other_row, column]
    other += np.float32(0.25) * coarse[other_row, other_column]
    return np.float32(0.75) * mixed + np.float32(0.25) * other


def grow(grid: Grid, values: Array, known: Mask, rings: int) -> None:
    """Give texels (T,) that are not ``known`` the mean ``values`` (T, K) of those about them that
    are, on the same piece of the ``grid``, in place; ``rings`` of them, each known to the next."""
    for _ in range(rings):
        rows = np.flatnonzero(~known)
        near = grid.neighbours(rows, AROUND)
        has = (near >= 0) & known[near]
        found = has.any(axis=1)
        rows, near, has = rows[found], near[found], has[found]
        sums = np.zeros((len(rows), values.shape[1]), np.float32)
        for k in range(len(AROUND)):
            sums += np.where(has[:, k, None], values[near[:, k]], 0)
        values[rows] = sums / has.sum(axis=1, dtype=np.float32)[:, None]
        known[rows] = True
