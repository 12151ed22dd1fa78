"""How the columns of an atlas lie in one picture: four to a tile, the tiles side by side.

Tile k holds columns 4 k .. 4 k + 3 as red, green, blue and alpha.  It is the (k % columns)-th tile
from the left in the (k // columns)-th row of tiles from the top.  All sizes are powers of two, so a
mip level of the picture is made of mip levels of its tiles, down to a texel each.
"""

LARGEST = 16384  # texels along a side that every graphics card takes


def tile_grid(count: int) -> tuple[int, int]:
    """Columns and rows, powers of two, of a picture of ``count`` tiles."""
    columns = rows = 1
    while columns * columns < count:
        columns *= 2
    while columns * rows < count:
        rows *= 2
    return columns, rows


def largest_size(count: int) -> int:
    """The largest power of two that a tile's side may be, where there are ``count``."""
    return LARGEST // max(tile_grid(count))
