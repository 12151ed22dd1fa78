"""Charts packed into a square as large as asked for, at the finest density that it has room for,
or into the smallest square for a density.

They are first put in rows, which is soon done and best for many small ones; then xatlas looks for
places at which they may be larger.
"""

from collections.abc import Generator
from dataclasses import dataclass
from math import ceil, log2
from typing import Any

import numpy as np
import numpy.typing as npt

from ..errors import BakeError
from .charting import Charts
from .children import Children
from .messages import Arrays
from .plane import plane_areas
from .shelves import Boxes

LARGEST = 16384  # texels along a side: what graphics cards read
SMALLEST = 16
MANY = 20_000  # charts: xatlas takes seconds for more, and rows of them are nearly as dense
FIRST = (0.5, 0.7)  # shares of the square that are tried first
CLOSE = 0.01  # of the density: nearer to the finest is not looked for
LEAST = 2.0**-12  # of the density that would fill the square: below, nothing fits

Array = npt.NDArray[Any]
Places = npt.NDArray[np.float32]
Tries = Generator[float, None, list[Places | None]]


@dataclass(frozen=True)
class Packed:
    """``uvs`` (F, 3, 2) float32 in 0 .. 1 of a square of ``size`` texels."""

    size: int
    uvs: Places


class Packer:
    """Tries places for ``charts``, ``padding`` texels apart and half that from the border: atlases
    may stand side by side in one image."""

    def __init__(self, charts: Charts, padding: int, children: Children) -> None:
        self._charts, self._children = charts, children
        self._padding, self._border = padding, (padding + 1) // 2
        corners = charts.uvs[charts.triangles]
        self._unit = float(plane_areas(corners).sum()) ** 0.5  # xatlas takes tiny charts for none
        self.count = int(charts.charts.max()) + 1
        self._boxes = Boxes(corners / self._unit, charts.charts)

    def into(self, size: int) -> Generator[float, None, Packed]:
        """All charts in ``size`` x ``size``, as fine as it goes; yields the share done."""
        room = size - 2 * self._border
        full = float(max(room, 0))  # the density that would leave no gap, the charts having area 1
        low = self._finest_in_rows(room, full)
        if not low:
            raise BakeError(
                f"{size} x {size} texels have no room for {self.count} charts that are "
                f"{self._padding} texels apart: choose a larger resolution, or smooth shading, "
                "which takes fewer charts"
            )
        best, high = self._boxes.packed(room, low, self._padding), full
        tried = tuple(full * share**0.5 for share in FIRST if full * share**0.5 > low)
        while self.count <= MANY and high > low * (1 + CLOSE):
            found = yield from self._share_done(self._try(room, tried), low, high)
            for density, places in zip(tried, found, strict=True):
                if places is None:
                    high = density
                    break
                best, low = places, density
            step = (high - low) / 3
            tried = (low + step, low + 2 * step)
        assert best is not None
        return self._packed(size, best)

    def _finest_in_rows(self, room: int, full: float) -> float:
        """The finest density at which the charts fit in rows, nearly; 0 where they don't."""
        if not self._boxes.fit(room, full * LEAST, self._padding):
            return 0.0
        low, high = full * LEAST, full
        while high > low * (1 + CLOSE / 4):
            middle = (low * high) ** 0.5
            if self._boxes.fit(room, middle, self._padding):
                low = middle
            else:
                high = middle
        return low

    def at(self, density: float) -> Generator[float, None, Packed]:
        """All charts at ``density`` texels a unit, in the smallest power of two that holds them."""
        least = max(self._unit * density, SMALLEST)
        size = 2 ** ceil(log2(least)) if least < LARGEST else 2 * LARGEST
        while size <= LARGEST:
            room, finest = size - 2 * self._border, density * self._unit
            places = self._boxes.packed(room, finest, self._padding)
            if places is None and self.count <= MANY and room > 0:
                (places,) = yield from self._try(room, (finest,))
            if places is not None:
                return self._packed(size, places)
            size *= 2
        raise BakeError(
            f"At {density:g} texels a metre the atlas would be larger than {LARGEST} x {LARGEST}: "
            "choose fewer, or an atlas for each object"
        )

    def _share_done(self, tries: Tries, low: float, high: float) -> Tries:
        """``tries``, with the share of the search that is done."""
        width = (high - low) / max(high, 1e-300)
        done = min(1.0, max(0.0, 1 - log2(1 + width / CLOSE) / log2(1 + 1 / CLOSE)))
        while True:
            try:
                next(tries)
            except StopIteration as stop:
                return list(stop.value)
            yield done

    def _try(self, room: int, densities: tuple[float, ...]) -> Tries:
        """Places at each of ``densities``, texels for the side of a square with the area of all
        charts, in a square of ``room`` texels."""
        answers = yield from self._children.answers([self._task(room, d) for d in densities])
        return [answer["places"] if len(answer["places"]) else None for answer in answers]

    def _task(self, room: int, density: float) -> Arrays:
        return {
            "uvs": self._charts.uvs / self._unit,
            "triangles": self._charts.triangles.astype(np.uint32),
            "charts": self._charts.charts.astype(np.uint32),
            "size": np.array([room]),
            "padding": np.array([self._padding]),
            "density": np.array([density]),
        }

    def _packed(self, size: int, places: Places) -> Packed:
        return Packed(size, (places + np.float32(self._border)) / np.float32(size))
