"""Which texels a bilinear read of the surface may touch, and which triangle each stands on.

A read mixes the four texels about it, so a texel is read wherever the surface comes nearer to its
centre than one texel along both axes.  All of these are found, not only those whose centres lie on
a triangle: what a read finds beyond a chart's border is what draws lines along seams.
"""

from collections.abc import Generator
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import numpy.typing as npt

from ..job import Receiver

Float = npt.NDArray[np.float64]
Index = npt.NDArray[np.int64]
Mask = npt.NDArray[np.bool_]

MARGIN = 1 / 128  # texels: a GPU rounds the place of a read to 1/256
PAIRS = 1 << 19  # of triangles and texels that are looked at together
NOWHERE = np.int64(2**63 - 1)
BLOCK = 8  # texels a side, which are asked for together
STEPS = 2.0**26  # of a distance of one texel
TRIANGLE = 0xFFFFFFFF  # the bits that hold a triangle's number


@dataclass(frozen=True)
class Layout:
    """A receiver's triangles in an atlas of ``size`` x ``size``: ``corners`` (F, 3, 2) in texels,
    the centre of row r, column c at (c, r)."""

    corners: Float
    size: int

    @classmethod
    def of(cls, receiver: Receiver, uvs: npt.NDArray[np.float32], size: int) -> "Layout":
        """From ``uvs`` (C, 2), one a corner of the receiver, in [0, 1]."""
        corners = np.asarray(uvs, np.float64)[np.asarray(receiver.triangle_corners)]
        return cls(np.clip(corners * size - 0.5, -0.5, size - 0.5), size)

    @cached_property
    def box(self) -> tuple[Float, Float]:
        """The lowest and the highest coordinates (2, F) of each triangle."""
        a, b, c = np.ascontiguousarray(self.corners.transpose(1, 2, 0))
        return np.minimum(np.minimum(a, b), c), np.maximum(np.maximum(a, b), c)


def cover(layout: Layout, solid: Mask) -> Generator[int, None, tuple[Index, Index, Mask]]:
    """The texels (T,) that reads of the triangles that are ``solid`` (F,) may touch, as flat
    indices in rising order, the triangle (T,) on or nearest to the centre of each, the first of
    equals, and which of the centres lie beside it (T,).

    Yields 0 now and then.
    """
    best = np.full(layout.size**2, NOWHERE)
    for texel, key in _pairs(layout, np.flatnonzero(solid), np.zeros(2)):
        np.minimum.at(best, texel, key)
        yield 0
    index = np.flatnonzero(best < NOWHERE)
    return index, best[index] & TRIANGLE, best[index] > TRIANGLE


def locate(
    layout: Layout, solid: Mask, offset: Float, texels: Index
) -> Generator[int, None, Index]:
    """For each of ``texels`` (M,), all different, that reads may touch, the solid triangle on or
    nearest to the place ``offset`` texels (2,) from its centre, the first of equals; else -1.

    Yields 0 now and then.
    """
    wanted: Mask = np.zeros(layout.size**2, bool)
    wanted[texels] = True
    used = np.flatnonzero(solid)
    used = used[_about(layout, used, wanted.reshape(layout.size, -1))]
    best, order = np.full(len(texels), NOWHERE), np.argsort(texels)
    for texel, key in _pairs(layout, used, offset, wanted):
        np.minimum.at(best, order[np.searchsorted(texels, texel, sorter=order)], key)
        yield 0
    return np.where(best == NOWHERE, -1, best & TRIANGLE)


def _pairs(
    layout: Layout, used: Index, offset: Float, wanted: Mask | None = None
) -> Generator[tuple[Index, Index], None, None]:
    """Texels (M,) that reads of the triangles ``used`` may touch, of those ``wanted`` (N²,), and of
    each the triangle in the low bits and, above, how far it is from the place ``offset`` texels
    (2,) from the texel's centre; in chunks."""
    size = layout.size
    for triangle, row in _rows(layout, used):
        low, high = _spans(layout.corners[triangle], row)
        first = np.clip(np.ceil(low - 1 - MARGIN), 0, size).astype(np.int64)
        last = np.clip(np.floor(high + 1 + MARGIN), -1, size - 1).astype(np.int64)
        counts = np.maximum(last - first + 1, 0)
        for piece in _pieces(counts):
            some = counts[piece]
            column = _runs(first[piece], some)
            of, r = np.repeat(triangle[piece], some), np.repeat(row[piece], some)
            texel = r * size + column
            if wanted is not None:
                chosen = wanted[texel]
                texel, of, column, r = texel[chosen], of[chosen], column[chosen], r[chosen]
            place = np.stack([column, r], axis=1) + offset
            distance = np.minimum(_distances(layout.corners, of, place) * STEPS, 2.0**30)
            yield texel, distance.astype(np.int64) << 32 | of


def _about(layout: Layout, used: Index, wanted: Mask) -> Mask:
    """Which of the triangles ``used`` (M,) may be read with a texel that is ``wanted`` (N, N):
    those that have one in the blocks of texels about them."""
    rows, columns = np.nonzero(wanted)
    count = len(wanted) // BLOCK + 1
    before = np.zeros((count + 1, count + 1), np.int64)  # of all rows and columns before each
    before[rows // BLOCK + 1, columns // BLOCK + 1] = 1
    before = before.cumsum(axis=0).cumsum(axis=1)
    (left, low), (right, high) = (
        np.clip(ends[:, used] / BLOCK, 0, count - 1).astype(np.int64)
        for ends in (layout.box[0] - 1 - MARGIN, layout.box[1] + 1 + MARGIN)
    )
    right, high = right + 1, high + 1
    counts = before[high, right] - before[low, right] - before[high, left] + before[low, left]
    return np.asarray(counts > 0)


def _rows(layout: Layout, used: Index) -> Generator[tuple[Index, Index], None, None]:
    """The triangles ``used`` with each row of texels whose reads they may touch, in chunks."""
    low, high = (ends[1, used] for ends in layout.box)
    first = np.clip(np.ceil(low - 1 - MARGIN), 0, layout.size - 1).astype(np.int64)
    last = np.clip(np.floor(high + 1 + MARGIN), 0, layout.size - 1).astype(np.int64)
    counts = last - first + 1
    for piece in _pieces(counts):
        yield np.repeat(used[piece], counts[piece]), _runs(first[piece], counts[piece])


def _pieces(counts: Index) -> list[slice]:
    """Slices of about PAIRS of what ``counts`` (M,) counts."""
    if not len(counts):
        return []
    block = np.cumsum(counts) // PAIRS
    cuts = np.flatnonzero(np.diff(block)) + 1
    ends = [*cuts.tolist(), len(counts)]
    return [slice(start, end) for start, end in zip([0, *cuts.tolist()], ends, strict=True)]


def _runs(first: Index, counts: Index) -> Index:
    """For each of ``first`` as many numbers from there on as ``counts`` says."""
    before = np.cumsum(counts) - counts
    return np.asarray(np.arange(int(counts.sum())) + np.repeat(first - before, counts))


def _spans(corners: Float, row: Index) -> tuple[Float, Float]:
    """From where to where along x the triangles ``corners`` (M, 3, 2) reach within a texel of each
    ``row`` (M,); low is above high where they don't."""
    low, high = np.full(len(row), np.inf), np.full(len(row), -np.inf)
    bottom, top = row - (1 + MARGIN), row + (1 + MARGIN)
    for k in range(3):
        (x0, y0), (x1, y1) = corners[:, k].T, corners[:, k - 2].T
        rise = y1 - y0
        steep = np.where(np.abs(rise) > 1e-12, rise, 1.0)
        at = np.sort(np.stack([(bottom - y0) / steep, (top - y0) / steep]), axis=0)
        level = np.abs(rise) <= 1e-12
        at[0][level], at[1][level] = 0, 1
        start, end = np.clip(at, 0, 1)
        meets = (at[0] <= 1) & (at[1] >= 0) & ~(level & ((y0 < bottom) | (y0 > top)))
        for t in (start, end):
            x = x0 + t * (x1 - x0)
            low = np.where(meets, np.minimum(low, x), low)
            high = np.where(meets, np.maximum(high, x), high)
    return low, high


def _distances(corners: Float, of: Index, places: Float) -> Float:
    """How far (M,) ``places`` (M, 2) lie from the triangles ``of`` (M,), 0 inside of them."""
    mine = corners[of]
    squared = np.full(len(of), np.inf)
    lefts = []
    for k in range(3):
        start, side = mine[:, k], mine[:, k - 2] - mine[:, k]
        to = places - start
        lefts.append(side[:, 0] * to[:, 1] - side[:, 1] * to[:, 0])
        length = np.maximum(np.einsum("mc,mc->m", side, side), 1e-30)
        along = np.clip(np.einsum("mc,mc->m", side, to) / length, 0, 1)
        away = to - along[:, None] * side
        squared = np.minimum(squared, np.einsum("mc,mc->m", away, away))
    turns = np.array(lefts)
    inside = (turns >= 0).all(axis=0) | (turns <= 0).all(axis=0)
    inside &= turns.any(axis=0)  # a triangle without area in the atlas has no inside
    return np.asarray(np.where(inside, 0.0, np.sqrt(squared)))


def barycentric(corners: Float, places: Float) -> Float:
    """Coordinates (M, 3) of the points of triangles ``corners`` (M, 3, 2) that are nearest to
    ``places`` (M, 2)."""
    best, found = np.full(len(places), np.inf), np.zeros((len(places), 3))
    first, second = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    to = places - corners[:, 0]
    area = first[:, 0] * second[:, 1] - first[:, 1] * second[:, 0]
    safe = np.where(area == 0, 1, area)
    u = (to[:, 0] * second[:, 1] - to[:, 1] * second[:, 0]) / safe
    v = (first[:, 0] * to[:, 1] - first[:, 1] * to[:, 0]) / safe
    inside = np.stack([1 - u - v, u, v], axis=1)
    is_in = (area != 0) & (inside >= 0).all(axis=1)
    for k in range(3):
        start, side = corners[:, k], corners[:, k - 2] - corners[:, k]
        length = np.maximum(np.einsum("mc,mc->m", side, side), 1e-30)
        along = np.clip(np.einsum("mc,mc->m", side, places - start) / length, 0, 1)
        away = places - start - along[:, None] * side
        squared = np.einsum("mc,mc->m", away, away)
        nearer = squared < best
        best = np.where(nearer, squared, best)
        on_side = np.zeros((len(places), 3))
        on_side[:, k], on_side[:, k - 2] = 1 - along, along
        found[nearer] = on_side[nearer]
    found[is_in] = inside[is_in]
    return found
