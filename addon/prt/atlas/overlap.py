"""Whether triangles in the plane lie over one another."""

from typing import Any

import numpy as np
import numpy.typing as npt

from ..surface.points import Float

ROWS = 512  # triangles compared at a time
TOUCH = 1e-6  # of a triangle's size: what overlaps by less only touches

Mask = npt.NDArray[np.bool_]


def over_any(some: Float, others: Float) -> Mask:
    """Which of the triangles ``some`` (S, 3, 2) share more than their border with one of
    ``others`` (T, 3, 2)."""
    low, high = some.min(axis=1), some.max(axis=1)
    other_low, other_high = others.min(axis=1), others.max(axis=1)
    near = np.ones((len(some), len(others)), bool)
    for k in range(2):
        near &= (low[:, None, k] < other_high[:, k]) & (high[:, None, k] > other_low[:, k])
    first, second = np.nonzero(near)
    found = np.zeros(len(some), bool)
    found[first[are_over(some[first], others[second])]] = True
    return found


def over_each_other(triangles: Float) -> Mask:
    """Which of ``triangles`` (T, 3, 2) share more than their border with another one."""
    low, high = triangles.min(axis=1), triangles.max(axis=1)
    if len(triangles) and np.ptp(low[:, 1]) > np.ptp(low[:, 0]):  # sorted along the longer axis
        low, high = low[:, ::-1], high[:, ::-1]
    order = np.argsort(low[:, 0], kind="stable")
    low, high, sorted_triangles = low[order], high[order], triangles[order]
    ends = np.searchsorted(low[:, 0], high[:, 0])
    found = np.zeros(len(triangles), bool)
    for start in range(0, len(order), ROWS):
        stop = min(start + ROWS, len(order))
        count = np.maximum(ends[start:stop] - np.arange(start, stop) - 1, 0)
        first = np.repeat(np.arange(start, stop), count)
        second = first + 1 + np.arange(len(first)) - np.repeat(np.cumsum(count) - count, count)
        near = (low[first, 1] < high[second, 1]) & (high[first, 1] > low[second, 1])
        first, second = first[near], second[near]
        over = are_over(sorted_triangles[first], sorted_triangles[second])
        found[first[over]] = found[second[over]] = True
    back = np.zeros(len(triangles), bool)
    back[order] = found
    return back


def are_over(first: npt.NDArray[Any], second: npt.NDArray[Any]) -> Mask:
    """Whether triangles (N, 3, 2) share more than their border with their partners (N, 3, 2); no
    line along a side parts them (the separating axis theorem)."""
    both = np.concatenate([first, second], axis=1)
    size = np.ptp(both, axis=1).max(axis=1, initial=0)
    over = np.ones(len(first), bool)
    for triangle in (first, second):
        for k in range(3):
            side = triangle[:, (k + 1) % 3] - triangle[:, k]
            length = np.hypot(side[:, 0], side[:, 1])
            across = np.stack([-side[:, 1], side[:, 0]], axis=1)
            across /= np.where(length > 0, length, 1)[:, None]
            here, there = (np.einsum("nkc,nc->nk", t, across) for t in (first, second))
            shared = np.minimum(here.max(axis=1), there.max(axis=1))
            shared -= np.maximum(here.min(axis=1), there.min(axis=1))
            over &= (shared > TOUCH * size) | (length == 0)
    return over
