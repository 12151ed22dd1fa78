"""Charts packed in rows, tallest first."""

from typing import Any

import numpy as np
import numpy.typing as npt

from ..surface.points import Float, Index

Array = npt.NDArray[Any]


class Boxes:
    """Charts turned so that their longest side lies along the first axis: ``uvs`` (F, 3, 2) from
    their box's corner on, in the unit of the surface, and their ``extents`` (C, 2)."""

    def __init__(self, uvs: Float, charts: Index) -> None:
        self._charts = charts
        turned = _turned(uvs, charts)
        count = int(charts.max()) + 1
        low, high = np.full((count, 2), np.inf), np.full((count, 2), -np.inf)
        np.minimum.at(low, charts, turned.min(axis=1))
        np.maximum.at(high, charts, turned.max(axis=1))
        self.uvs, self.extents = turned - low[charts][:, None], high - low

    def fit(self, size: int, density: float, padding: int) -> bool:
        """Whether the charts fit into a square of ``size`` texels at ``density`` texels a unit."""
        return self._places(size, density, padding) is not None

    def packed(self, size: int, density: float, padding: int) -> npt.NDArray[np.float32] | None:
        """UVs (F, 3, 2) in texels of the charts in such a square, ``padding`` texels apart; None
        where they don't fit."""
        places = self._places(size, density, padding)
        if places is None:
            return None
        return np.asarray(self.uvs * density + places[self._charts][:, None] + 0.5, np.float32)

    def _places(self, size: int, density: float, padding: int) -> Float | None:
        """The lower left corner (C, 2) of each chart's box."""
        gap = max(1, padding)
        boxes = np.ceil(self.extents * density).astype(np.int64) + gap
        order = np.lexsort((-boxes[:, 0], -boxes[:, 1]))
        width, room = boxes[order, 0], size + gap - 1
        if width.max() > room:
            return None
        ends, places = np.cumsum(width), np.empty((len(boxes), 2))
        start = bottom = 0
        while start < len(order) and bottom <= room:
            before = int(ends[start] - width[start])
            end = int(np.searchsorted(ends, before + room, side="right"))
            row = order[start:end]
            places[row, 0] = ends[start:end] - width[start:end] - before
            places[row, 1] = bottom
            bottom += int(boxes[row[0], 1])
            start = end
        return places if bottom <= room else None


def _turned(uvs: Float, charts: Index) -> Float:
    """``uvs`` (F, 3, 2) with each chart's longest side along the first axis."""
    sides = (uvs[:, [1, 2, 0]] - uvs).reshape(-1, 2)
    order = np.lexsort((np.hypot(*sides.T), np.repeat(charts, 3)))
    last = np.flatnonzero(np.diff(np.repeat(charts, 3)[order], append=-1))
    longest = sides[order[last]]
    u = longest / np.maximum(np.hypot(*longest.T), 1e-300)[:, None]
    axes = np.stack([u, np.stack([-u[:, 1], u[:, 0]], axis=1)], axis=1)
    return np.asarray(np.einsum("fij,fkj->fki", axes[charts], uvs))
