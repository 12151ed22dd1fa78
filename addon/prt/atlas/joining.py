"""Small charts taken into the larger ones beside them.

Where xatlas finds no plane for a rough surface it takes it apart, down to single triangles, each of
which costs its gaps and a seam.  Most of them fit into a neighbour.
"""

import numpy as np

from ..surface.points import Index
from .layout import Layout
from .pieces import polygons_of

SMALL = 10  # triangles of a chart: taking larger ones apart leaves as many crumbs
LEAST = 0.5  # of its length: no side of a polygon that is moved is shorter


def join_small(layout: Layout) -> None:
    """Move polygons of small charts of ``layout`` into larger charts where these have room."""
    while True:
        sizes = np.bincount(layout.charts)
        small = np.flatnonzero((sizes > 0) & (sizes <= SMALL))
        small = small[np.argsort(sizes[small], kind="stable")]
        if not sum(_emptied(layout, int(chart)) for chart in small):  # none is left, or has room
            return


def _emptied(layout: Layout, chart: int) -> int:
    """How many polygons of ``chart`` were moved."""
    left = _polygons(layout, chart)
    count = len(left)
    while left:
        before = len(left)
        left = [polygon for polygon in left if not _moved(layout, polygon, chart)]
        if len(left) == before:
            break
    return count - len(left)


def _polygons(layout: Layout, chart: int) -> list[Index]:
    inside = np.flatnonzero(layout.charts == chart)
    names = polygons_of(layout.loops[inside])
    return [inside[names == name] for name in range(int(names.max(initial=-1)) + 1)]


def _moved(layout: Layout, polygon: Index, chart: int) -> bool:
    """Whether ``polygon`` went from ``chart`` into a larger one."""
    sizes = np.bincount(layout.charts)
    return any(
        sizes[other] > sizes[chart] and layout.move(polygon, other, LEAST)
        for other in layout.candidates(polygon)
    )
