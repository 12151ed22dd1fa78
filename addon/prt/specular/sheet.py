"""Everything that reflections read, in one image.

From below: a strip with two tables, then four rows of four cells with the filtered radiance of
``ROUGHNESSES``, the sharpest first, from the left and from below, then the picture itself.  All are
lat-long maps as in Blender, with gutters that go on over the wrap and the poles.  It is read at
full resolution, never from a mip level (``reads``): so neither the wrap of the azimuth nor the
border between two levels shows.

The left table holds A and B of the split sum, and s and q of the look-up, as red, green, blue and
alpha over sqrt(n_v), to the right, and the roughness, up.
The right one holds, over the roughness alone, up to that of the last level, ``(1 + z_l) / 2`` of
the lobe's zonal factors l = 1 .. 4 as red, green, blue and alpha.
"""

from collections.abc import Generator, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from ..steps import value_of
from . import brdf, look_up, prefilter, reads, table

Array = npt.NDArray[np.float32]
Float = npt.NDArray[np.float64]

CELLS = 16  # filtered levels
COLUMNS = 4
A_DOUBLING = 4  # so many levels on the roughness is twice as large
SHARPEST = look_up.ROUGHEST * 2.0 ** (-(CELLS - 1) / A_DOUBLING)  # the roughness of the first
ROUGHNESSES = SHARPEST * 2.0 ** (np.arange(CELLS) / A_DOUBLING)
GUTTER = (4, 2)  # texels left and right, above and below
CELL = (512, 256)  # with its gutters
PLAIN = (64, 32)  # the same under a world of one colour
TILE = table.SIZE + 4
NODE = 2.5  # where the first node of a table is, in texels
LARGEST_HALF = 60000.0


@dataclass(frozen=True)
class Sheet:
    """Where things are in an image of reflections: a ``cell`` is so many texels wide and high, the
    picture ``detail`` times that.  Stored values times ``scale`` are radiance."""

    cell: tuple[int, int] = CELL
    detail: int = 2
    scale: float = 1.0

    @classmethod
    def of(cls, values: Mapping[str, Any]) -> "Sheet":
        """The sheet whose fields are ``values``, as files keep them."""
        width, height = values["cell"]
        return cls((width, height), values["detail"], values["scale"])

    @property
    def size(self) -> tuple[int, int]:
        """Width and height of the image."""
        return max(COLUMNS * self.cell[0], 2 * TILE), TILE + (COLUMNS + self.detail) * self.cell[1]

    @property
    def inner(self) -> tuple[int, int]:
        """Width and height of a level without its gutters."""
        return self.cell[0] - 2 * GUTTER[0], self.cell[1] - 2 * GUTTER[1]

    @property
    def picture(self) -> tuple[int, int]:
        """Width and height of the picture without its gutters."""
        width, height = (self.detail * side for side in self.cell)
        return width - 2 * GUTTER[0], height - 2 * GUTTER[1]

    def cell_corner(self, level: int) -> tuple[int, int]:
        """Left and lower border of a level, its gutter left out."""
        column, row = level % COLUMNS, level // COLUMNS
        return self.cell[0] * column + GUTTER[0], TILE + self.cell[1] * row + GUTTER[1]

    @property
    def picture_corner(self) -> tuple[int, int]:
        """The same of the picture."""
        return GUTTER[0], TILE + COLUMNS * self.cell[1] + GUTTER[1]


def make(
    pixels: Array | None, threads: int = 0, cell: tuple[int, int] = CELL
) -> tuple[Sheet, Array]:
    """``fill`` from beginning to end."""
    return value_of(fill(pixels, threads, cell))


def fill(
    pixels: Array | None, threads: int = 0, cell: tuple[int, int] = CELL
) -> Generator[float, None, tuple[Sheet, Array]]:
    """The image (H, W, 4) float32, row 0 at the bottom, for ``pixels`` (H, W, 3), a lat-long map,
    top row first; None is 1 from everywhere.  Yields how much is done."""
    sheet = Sheet(PLAIN, 1)
    if pixels is None:
        pixels = np.ones((2, 4, 3), np.float32)
    elif pixels.size:
        scale = max(1.0, float(pixels.max()) / LARGEST_HALF)
        sheet = Sheet(cell, _detail(pixels.shape[1]), scale)
        pixels = pixels / np.float32(scale)
    width, height = sheet.size
    image = np.zeros((height, width, 4), np.float32)
    image[..., 3] = 1
    image[:TILE, : 2 * TILE] = _tables()
    base = prefilter.resampled(pixels, *sheet.picture[::-1])
    _place(image, sheet.picture_corner, base)
    steps = prefilter.levels(pixels, ROUGHNESSES, *sheet.inner[::-1], threads)
    for level, values in enumerate(steps):
        _place(image, sheet.cell_corner(level), values)
        yield (level + 1) / CELLS
    return sheet, image


def radiance(
    sheet: Sheet, image: npt.ArrayLike, directions: npt.ArrayLike, roughness: npt.ArrayLike
) -> Float:
    """What the nodes read: the filtered radiance (P, 3) about unit ``directions`` (P, 3), in the
    picture's own frame.

    Between two levels it is linear in the logarithm of the roughness; between the picture and the
    first level in its square.
    """
    values, towards = np.asarray(image), np.asarray(directions, np.float64)
    u = 0.5 - np.arctan2(towards[:, 1], towards[:, 0]) / (2 * np.pi)
    v = 0.5 + np.arcsin(np.clip(towards[:, 2], -1, 1)) / np.pi
    rough = np.broadcast_to(np.asarray(roughness, np.float64), len(towards))
    place = A_DOUBLING * np.log2(np.maximum(rough, SHARPEST) / SHARPEST)
    level = np.minimum(np.floor(place), CELLS - 2).astype(np.int64)
    smooth = rough < SHARPEST
    upper = np.where(smooth, 0, level + 1)
    share = np.where(smooth, np.square(rough / SHARPEST), np.minimum(place, CELLS - 1) - level)
    sharp = _read_picture(sheet, values, u, v)
    first = np.where(smooth[:, None], sharp, _read_level(sheet, values, level, u, v))
    second = _read_level(sheet, values, upper, u, v)
    found = first + share[:, None] * (second - first)
    return np.asarray(np.maximum(found, 0) * sheet.scale)


def split_sum(image: npt.ArrayLike, roughness: npt.ArrayLike, n_v: npt.ArrayLike) -> Float:
    """``A`` and ``B`` (P, 2) as the nodes read them."""
    across = np.sqrt(np.asarray(n_v, np.float64)) * (table.SIZE - 1)
    up = np.asarray(roughness, np.float64) * (table.SIZE - 1)
    return reads.bilinear(np.asarray(image)[..., :2], across + NODE, up + NODE)


def zonal_factors(roughness: npt.ArrayLike) -> Float:
    """``z_l`` (P, 5), l = 0 .. 4: the mean of the Legendre polynomials of the angle to the look-up
    direction under the lobe of each ``roughness`` (P,), so that z_0 is 1."""
    rough = np.atleast_1d(np.asarray(roughness, np.float64))
    nodes, weights = np.polynomial.legendre.leggauss(400)
    t = 0.5 * (nodes + 1)  # tan(angle / 2) = alpha tan(t end): as wide a peak for every roughness
    alpha = np.maximum(np.square(rough), 1e-6)[:, None]
    end = np.arctan(1 / alpha)
    half = np.arctan(alpha * np.tan(end * t))
    cosine = np.cos(2 * half)
    measure = np.square(np.cos(half)) / np.square(np.cos(end * t)) * alpha * end * np.sin(2 * half)
    weight = brdf.distribution(alpha, np.cos(half)) * np.maximum(cosine, 0) * measure * weights
    polynomials = map(np.polynomial.legendre.Legendre.basis, range(5))
    legendre = np.stack([polynomial(cosine) for polynomial in polynomials])
    moments = np.einsum("lpn,pn->pl", legendre, weight)
    return np.asarray(moments / moments[:, :1])


def _detail(width: int) -> int:
    """How many cells wide the picture is: as large as it is, within bounds."""
    return 1 if width <= CELL[0] else 2 if width <= 2 * CELL[0] else 4


def _tables() -> Array:
    """The strip (TILE, 2 TILE, 4)."""
    nodes = np.empty((2, table.SIZE, table.SIZE, 4))
    nodes[0] = np.concatenate([table.load(), look_up.load()], axis=2)
    factors = zonal_factors(np.linspace(0, look_up.ROUGHEST, table.SIZE))[:, 1:]
    nodes[1] = 0.5 + 0.5 * factors[:, None]
    tiles = np.pad(nodes, ((0, 0), (2, 2), (2, 2), (0, 0)), mode="edge")
    return np.concatenate([*tiles], axis=1).astype(np.float32)


def _place(image: Array, corner: tuple[int, int], values: Array) -> None:
    """Put a lat-long map ``values`` (h, w, 3), top row first, at ``corner``, with its gutters."""
    (x, y), (across, down) = corner, GUTTER
    height, width = values.shape[:2]
    beyond = [np.roll(edge[::-1], width // 2, axis=1) for edge in (values[:down], values[-down:])]
    whole = np.concatenate([beyond[0], values, beyond[1]])[::-1]
    whole = np.concatenate([whole[:, -across:], whole, whole[:, :across]], axis=1)
    image[y - down : y + height + down, x - across : x + width + across, :3] = whole


def _read_picture(sheet: Sheet, image: Array, u: Float, v: Float) -> Float:
    (x, y), (width, height) = sheet.picture_corner, sheet.picture
    return reads.bilinear(image[..., :3], x + u * width, y + v * height)


def _read_level(
    sheet: Sheet, image: Array, level: npt.NDArray[np.int64], u: Float, v: Float
) -> Float:
    (x, y), (width, height) = sheet.cell_corner(0), sheet.inner
    x_of = x + level % COLUMNS * sheet.cell[0] + u * width
    y_of = y + level // COLUMNS * sheet.cell[1] + v * height
    return reads.bilinear(image[..., :3], x_of, y_of)
