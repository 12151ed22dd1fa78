"""Charts of pieces, and their packing.  The only module that imports xatlas.

xatlas holds Python's lock until it is done and prints its doubts to the standard output, so this
runs in a child process, see ``worker``.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from ..surface.edges import components
from ..surface.points import Float, Index
from .joining import join_small
from .layout import NEITHER, Layout
from .plane import are_flat, cross_products, plane_areas, projected

RASTER = 512  # texels along a piece's side while it is unwrapped
LONGEST = 8192  # of them along its longest
SMALL = (
    1e-8  # of the mean area: xatlas is given a unit in which no triangle, down to here, is small
)

LARGE = 64  # texels along a chart's side: rounding to whole texels is little there
SHRUNK = 0.9  # of its area

Array = npt.NDArray[Any]

_atlases: list[Any] = []  # xatlas's own, not deleted yet


@dataclass(frozen=True)
class Charts:
    """Triangles in the plane: ``uvs`` (N, 2) float64 in the unit of the surface, ``triangles``
    (F, 3) of them, and the chart of each (F,)."""

    uvs: Float
    triangles: Index
    charts: Index


def unwrapped(vertices: Float, triangles: Index, loops: Index, pieces: Index) -> Charts:
    """Charts of ``triangles`` (F, 3) over ``vertices`` (V, 3); ``loops`` (F, 3) are the numbers of
    their corners and ``pieces`` (F,), in order, what they belong to."""
    corners = vertices[triangles]
    uvs, charts = np.zeros((len(triangles), 3, 2)), np.empty(len(triangles), np.int64)
    starts = np.flatnonzero(np.diff(pieces, prepend=-1))
    flat = are_flat(
        corners, np.repeat(np.arange(len(starts)), np.diff([*starts, len(pieces)])), len(starts)
    )
    count = 0
    for start, end, is_flat in zip(starts, [*starts[1:], len(pieces)], flat, strict=True):
        some = slice(int(start), int(end))
        if is_flat:
            uvs[some], charts[some] = _projected(corners[some]), 0
        else:
            piece = _piece(vertices, triangles[some], loops[some])
            uvs[some], charts[some] = piece.uvs, piece.charts
        charts[some] += count
        count = int(charts[some].max()) + 1
    return _shared(uvs, triangles, charts)


def packed(
    charts: Charts, size: int, density: float, padding: int
) -> npt.NDArray[np.float32] | None:
    """UVs (F, 3, 2) in texels of ``charts`` that are packed into a square of ``size`` texels, at
    ``density`` texels a unit; None where they don't fit."""
    import xatlas

    corners = charts.uvs[charts.triangles]
    unit = smallest(np.abs(plane_areas(corners)))
    atlas = _new_atlas()
    atlas.add_uv_mesh(
        np.ascontiguousarray(charts.uvs / unit, np.float32),
        np.ascontiguousarray(charts.triangles, np.uint32),
        np.ascontiguousarray(charts.charts, np.uint32)[:, None],
    )
    options = xatlas.PackOptions()
    options.resolution, options.texels_per_unit = size, density * unit
    options.padding = padding // 2  # kept about every chart, so that it counts twice, and one more
    atlas.generate(xatlas.ChartOptions(), options)
    if atlas.atlas_count != 1 or (atlas.width, atlas.height) != (size, size):
        return None
    _, faces, places = atlas.get_mesh(0)
    found = places[faces] * np.float32(size)
    return found if _to_scale(corners * density, found, charts.charts) else None


def delete_atlases() -> None:
    """Delete what xatlas made.  Once in some thousand times that never ends: it tells its threads
    to stop without holding the lock that they sleep by, and one that falls asleep just then is
    waited for for ever."""
    _atlases.clear()


def _new_atlas() -> Any:
    """An atlas of xatlas that lives until ``delete_atlases``."""
    import xatlas

    _atlases.append(xatlas.Atlas())
    return _atlases[-1]


def smallest(areas: Float) -> float:
    """A unit of length in which no triangle of ``areas`` (F,) is small."""
    return float(np.sqrt(max(areas.min(), SMALL * areas.mean())))


def _to_scale(asked: Float, found: Array, charts: Index) -> bool:
    """Whether charts came out as large as ``asked`` (F, 3, 2), but for rounding to whole texels;
    xatlas makes what is larger than the atlas smaller, and may forget what it finds too small."""
    sizes = np.bincount(charts, np.abs(plane_areas(asked)))
    areas = np.bincount(charts, np.abs(plane_areas(found)))
    if (areas < SHRUNK * sizes)[sizes > LARGE**2].any():
        return False
    reaches = []
    for corners in (asked, found):
        first = np.zeros((len(sizes), 2))
        first[charts[::-1]] = corners[::-1, 0]
        reach = np.zeros(len(sizes))
        away = np.abs(corners - first[charts][:, None])
        np.maximum.at(reach, charts, np.hypot(away[..., 0], away[..., 1]).max(axis=1))
        reaches.append(reach)
    return bool((reaches[1] <= 1.2 * reaches[0] + 3).all())


def _projected(corners: Float) -> Float:
    cross = cross_products(corners).sum(axis=0)
    normal = cross / np.linalg.norm(cross)
    return projected((corners - corners[0, 0]).reshape(-1, 3), normal).reshape(-1, 3, 2)


def _piece(vertices: Float, triangles: Index, loops: Index) -> Layout:
    """One piece, unwrapped in a unit in which none of its triangles is small."""
    corners = vertices[triangles]
    unit = smallest(0.5 * np.linalg.norm(cross_products(corners), axis=1))
    corners = (corners - corners.reshape(-1, 3).mean(axis=0)) / unit
    count = len(triangles)
    layout = Layout(
        corners, triangles, loops, np.zeros((count, 3, 2)), np.full(count, NEITHER, np.int64)
    )
    if count > 1:
        _parametrize(layout)
        layout.true_to_scale()
    layout.mend()
    join_small(layout)
    layout.level()
    layout.uvs *= unit
    return layout


def _parametrize(layout: Layout) -> None:
    """Let xatlas place the triangles of ``layout``."""
    import xatlas

    corners = layout.corners
    _, first, triangles = np.unique(layout.vertices, return_index=True, return_inverse=True)
    atlas = _new_atlas()
    atlas.add_mesh(
        np.ascontiguousarray(corners.reshape(-1, 3)[first], np.float32),
        np.ascontiguousarray(triangles.reshape(-1, 3), np.uint32),
    )
    options = xatlas.PackOptions()
    area = 0.5 * float(np.linalg.norm(cross_products(corners), axis=1).sum())
    extent = float(np.ptp(corners.reshape(-1, 3), axis=0).max())
    options.texels_per_unit = min(RASTER / area**0.5, LONGEST / extent)
    options.bilinear = False
    atlas.generate(xatlas.ChartOptions(), options)
    if not atlas.atlas_count:
        return
    _, faces, uvs = atlas.get_mesh(0)
    layout.uvs[:] = uvs[faces] * np.array([atlas.width, atlas.height], np.float64)
    for number in range(atlas.get_mesh_chart_count(0)):
        layout.charts[atlas.get_mesh_chart(0, number).faces] = number


def _shared(uvs: Float, vertices: Index, charts: Index) -> Charts:
    """Corners at the same vertex and UV (F, 3, 2) of a chart as one; what hangs together by edges
    is a chart, and shares no corner with another one: xatlas would lose it."""
    keys = np.concatenate(
        [np.repeat(charts, 3)[:, None], vertices.reshape(-1, 1), uvs.reshape(-1, 2).view(np.int64)],
        axis=1,
    )
    order = np.lexsort(keys.T)
    new = np.ones(len(order), bool)
    new[1:] = (keys[order][1:] != keys[order][:-1]).any(axis=1)
    place = np.empty(len(order), np.int64)
    place[order] = np.cumsum(new) - 1
    parts = _connected(place.reshape(-1, 3))
    key = place * (int(parts.max(initial=0)) + 1) + np.repeat(parts, 3)
    _, first, shared = np.unique(key, return_index=True, return_inverse=True)
    return Charts(uvs.reshape(-1, 2)[first], shared.reshape(-1, 3), parts)


def _connected(triangles: Index) -> Index:
    """Numbers (F,) of the parts that ``triangles`` (F, 3) make where they share edges: what only
    touches at a vertex is packed apart."""
    ends = triangles[:, [1, 2, 0]].reshape(-1), triangles.reshape(-1)
    key = np.minimum(*ends) * (int(triangles.max()) + 1) + np.maximum(*ends)
    order = np.argsort(key, kind="stable")
    same = np.flatnonzero(key[order][1:] == key[order][:-1])
    pairs = np.stack([order[same], order[same + 1]], axis=1) // 3
    _, names = np.unique(components(pairs, len(triangles)), return_inverse=True)
    return np.asarray(names.reshape(-1), np.int64)
