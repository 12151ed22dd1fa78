"""UV maps, ours or the artist's: their charts, and whether texels can be baked through them."""

from typing import Any

import numpy as np
import numpy.typing as npt

from ..job import Receiver
from ..surface.edges import components, welded
from ..surface.points import Float, Index, Surface
from .plane import plane_areas

OUTSIDE = 1e-5  # of the square: what rounding may put a UV outside by
COLLAPSED = 1e-3  # of the surface may have no area in the UV map
OVERLAPPING = 1e-4  # of the covered samples may be covered twice
SAMPLES = (1024, 4096)  # along a side, the fewest and the most: finer overlaps are not seen
IN_A_TRIANGLE = 4  # samples at the mean, if there can be as many
INSIDE = 0.01  # of the way between samples: nearer to a side counts as outside
PART = 1 << 22  # samples looked at together

Array = npt.NDArray[Any]


def charts(receiver: Receiver, uvs: Array) -> npt.NDArray[np.int32]:
    """The chart of each triangle (F,), numbered from 0: triangles are of one chart where they meet
    at an edge on the surface and in the UV map, ``uvs`` (C, 2) at ``receiver``'s corners."""
    count = len(receiver.triangles)
    corners = np.asarray(receiver.triangle_corners).reshape(-1)
    places = welded(receiver.vertices)[np.asarray(receiver.triangles).reshape(-1)]
    bits = (np.asarray(uvs, np.float32)[corners] + np.float32(0)).view(np.uint32)
    ends = _numbered([places, bits[:, 0], bits[:, 1]]).reshape(-1, 3)
    start, end = ends.reshape(-1), ends[:, [1, 2, 0]].reshape(-1)
    key = np.minimum(start, end) * (3 * count + 1) + np.maximum(start, end)
    order = np.argsort(key, kind="stable")
    same = (key[order][1:] == key[order][:-1]) & (start != end)[order][1:]
    pairs = np.stack([order[:-1], order[1:]], axis=1)[same] // 3
    _, names = np.unique(components(pairs, count), return_inverse=True)
    return names.reshape(-1).astype(np.int32)


def problem(receiver: Receiver, uvs: Array) -> str | None:
    """What stands against baking ``receiver`` through its own ``uvs`` (C, 2), in one sentence; None
    where nothing does."""
    surface = Surface.of(receiver)
    corners = np.asarray(uvs, np.float64)[receiver.triangle_corners[surface.solid]]
    name = f"The UV map of object {receiver.name!r}"
    if not np.isfinite(corners).all():
        return f"{name} has places that are NaN or infinite: let it be unwrapped anew"
    outside = ((corners < -OUTSIDE) | (corners > 1 + OUTSIDE)).any(axis=(1, 2))
    if outside.any():
        return f"{name} reaches outside of its square: move it inside, or let it be unwrapped anew"
    areas = surface.areas[surface.solid]
    size = np.ptp(corners, axis=1).max(axis=1)
    empty = np.abs(plane_areas(corners)) <= 1e-6 * size**2
    if areas[empty].sum() > COLLAPSED * areas.sum():
        share = 100 * float(areas[empty].sum() / areas.sum())
        return f"{name} gives {share:.3g} % of its surface no area: let it be unwrapped anew"
    share = overlap(corners[~empty])
    if share > OVERLAPPING:
        return (
            f"{name} lies over itself in {100 * share:.2g} % of its area: let it be unwrapped anew"
        )
    return None


def overlap(corners: Float) -> float:
    """Which share of the plane that triangles (F, 3, 2) cover they cover more than once, of samples
    in a grid over the unit square."""
    mean = float(np.abs(plane_areas(corners)).mean()) if len(corners) else 1.0
    side = int(np.clip((IN_A_TRIANGLE / max(mean, 1e-12)) ** 0.5, *SAMPLES))
    covered = np.zeros(side * side, np.uint8)
    spans = np.maximum(np.ceil(np.ptp(corners * side, axis=1)).prod(axis=1), 1)
    part = (np.cumsum(spans) // PART).astype(np.int64)
    for group in np.split(np.arange(len(corners)), np.flatnonzero(np.diff(part)) + 1):
        inside = _samples_inside(corners[group] * side, side)
        counts = np.bincount(inside, minlength=0)
        covered[: len(counts)] += np.minimum(counts, 2).astype(np.uint8)
        np.minimum(covered, 2, out=covered)
    total = np.count_nonzero(covered)
    return float(np.count_nonzero(covered > 1) / total) if total else 0.0


def _samples_inside(corners: Float, side: int) -> Index:
    """The samples, at the middles of unit squares, that lie well inside of each triangle
    (F, 3, 2), one after another; of ``side`` x ``side``, row by row."""
    low = np.clip(np.ceil(corners.min(axis=1) - 0.5), 0, side).astype(np.int64)
    high = np.clip(np.floor(corners.max(axis=1) - 0.5) + 1, low, side).astype(np.int64)
    width = high - low
    count = width.prod(axis=1)
    triangle = np.repeat(np.arange(len(corners)), count)
    within = np.arange(len(triangle)) - np.repeat(np.cumsum(count) - count, count)
    row, column = np.divmod(within, np.maximum(width[triangle, 0], 1))
    column, row = column + low[triangle, 0], row + low[triangle, 1]
    turn = np.sign(plane_areas(corners))[triangle]
    inside = np.ones(len(triangle), bool)
    for k in range(3):
        start, along = corners[:, k], corners[:, (k + 1) % 3] - corners[:, k]
        along = along / np.maximum(np.hypot(*along.T), 1e-300)[:, None]
        x, y = column + 0.5 - start[triangle, 0], row + 0.5 - start[triangle, 1]
        inside &= turn * (along[triangle, 0] * y - along[triangle, 1] * x) > INSIDE
    return np.asarray(row[inside] * side + column[inside])


def _numbered(columns: list[Array]) -> Index:
    """A number (N,) for each row of ``columns``, the same for equal ones."""
    order = np.lexsort(columns)
    new = np.zeros(len(order), bool)
    for column in columns:
        new[1:] |= column[order][1:] != column[order][:-1]
    numbers = np.empty(len(order), np.int64)
    numbers[order] = np.cumsum(new)
    return numbers
