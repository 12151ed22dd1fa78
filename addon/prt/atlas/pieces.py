"""A mesh cut into pieces that are unwrapped apart.

A piece is connected over edges that light runs on over, and holds both sides of no other edge; so
whatever charts it is unwrapped to, none of them crosses a crease, a border or an edge of more than
two triangles.  Polygons stay whole: their triangles share corners, and a corner has one UV.
"""

from collections.abc import Generator
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from ..job import Receiver
from ..surface.edges import components, edges_of, welded
from ..surface.points import Float, Index
from .plane import are_flat, cross_products

MAX_TRIANGLES = 2500  # of a piece: xatlas's time grows faster than its triangles
LONG = 4.0  # times as long as high: xatlas takes longer for triangles that are longer than this
MOST = 4.0  # times as many as it is does such a triangle count, at most
CRUMB = 0.2  # of a half: a part of it that is smaller goes to the other half

Mask = npt.NDArray[np.bool_]


@dataclass(frozen=True)
class Pieces:
    """The piece of each triangle (F,), in the order of their first triangles, their ``count``,
    the polygon of each triangle (F,), and the ``positions`` (V,) of the vertices, as ``welded``
    numbers them."""

    of_triangles: Index
    count: int
    polygons: Index
    positions: Index


@dataclass(frozen=True)
class _Graph:
    """Polygons: the bounds of each, ``low`` and ``high`` (P, 3), their ``weights`` (P,), triangles
    by how long they take; which may lie in a piece together, ``joined`` (E, 2), and which must not,
    ``apart`` (A, 2)."""

    low: Float
    high: Float
    weights: Float
    joined: Index
    apart: Index


def pieces_of(
    receiver: Receiver, reach: float, limit: int = MAX_TRIANGLES
) -> Generator[None, None, Pieces]:
    """``receiver`` in pieces of at most ``limit`` triangles, fewer where these are long, unless
    they are flat, and no longer than ``reach``; of one polygon where that can't be.  Yields now
    and then."""
    positions = welded(receiver.vertices)
    polygons = polygons_of(np.asarray(receiver.triangle_corners))
    yield
    corners = np.asarray(receiver.vertices, np.float64)[receiver.triangles]
    graph = _graph(receiver, corners, positions, polygons)
    yield
    piece = components(graph.joined, len(graph.weights))
    of_triangles = piece[polygons]
    flat = are_flat(corners, of_triangles, len(piece))[piece]
    yield
    piece = yield from _in_halves(graph, piece, flat, reach, limit)
    piece = yield from _without_creases(graph, piece)
    of_triangles = piece[polygons]
    _, first, names = np.unique(of_triangles, return_index=True, return_inverse=True)
    rank = np.empty(len(first), np.int64)
    rank[np.argsort(first)] = np.arange(len(first))
    return Pieces(rank[names.reshape(-1)], len(first), polygons, positions)


def polygons_of(corners: npt.NDArray[Any]) -> Index:
    """The polygon of each triangle (F,): triangles that share a corner are of one."""
    flat = corners.reshape(-1)
    order = np.argsort(flat, kind="stable")
    same = np.flatnonzero(flat[order][1:] == flat[order][:-1])
    pairs = np.stack([order[same], order[same + 1]], axis=1) // 3
    _, names = np.unique(components(pairs, len(corners)), return_inverse=True)
    return np.asarray(names.reshape(-1), np.int64)


def _graph(receiver: Receiver, corners: Float, positions: Index, polygons: Index) -> _Graph:
    edges = edges_of(receiver, positions)
    pairs = polygons[edges.triangles]
    between = pairs[:, 0] != pairs[:, 1]
    order = np.argsort(polygons, kind="stable")
    starts = np.flatnonzero(np.diff(polygons[order], prepend=-1))
    return _Graph(
        np.minimum.reduceat(corners.min(axis=1)[order], starts),
        np.maximum.reduceat(corners.max(axis=1)[order], starts),
        np.bincount(polygons, _efforts(corners)),
        pairs[edges.joined & between],
        pairs[~edges.joined & between],
    )


def _efforts(corners: Float) -> Float:
    """How many triangles each of ``corners`` (F, 3, 3) counts for."""
    sides = corners - corners[:, [1, 2, 0]]
    longest = np.einsum("fkc,fkc->fk", sides, sides).max(axis=1)
    doubled = np.maximum(np.linalg.norm(cross_products(corners), axis=1), 1e-300)
    return np.asarray(np.clip(np.sqrt(longest / doubled / LONG), 1, MOST))


def _in_halves(
    graph: _Graph, piece: Index, flat: Mask, reach: float, limit: int
) -> Generator[None, None, Index]:
    """``piece`` (P,), connected, cut at medians along their longest sides until none is longer than
    ``reach``, nor, unless it is ``flat`` (P,), has more than ``limit`` triangles."""
    count = len(graph.weights)
    joined = graph.joined
    while True:
        large = np.flatnonzero(_too_large(graph, piece, flat, reach, limit))
        if not len(large):
            return piece
        side = np.zeros(count, np.int64)
        side[large] = _sides(graph.low[large] + graph.high[large], piece[large])
        joined = joined[piece[joined[:, 0]] == piece[joined[:, 1]]]
        for half in (1, 0):
            crumbs = _crumbs(graph, joined, piece, side)
            side[crumbs & (side == half)] ^= 1
            yield
        whole = side[joined[:, 0]] == side[joined[:, 1]]
        piece = components(joined[whole], count)


def _too_large(graph: _Graph, piece: Index, flat: Mask, reach: float, limit: int) -> Mask:
    """Polygons (P,) of pieces that have to be cut and can be."""
    count = len(piece)
    triangles = np.bincount(piece, graph.weights, count)
    order = np.argsort(piece, kind="stable")
    starts = np.flatnonzero(np.diff(piece[order], prepend=-1))
    high = np.maximum.reduceat(graph.high[order], starts)
    extent = np.zeros(count)
    extent[piece[order][starts]] = (high - np.minimum.reduceat(graph.low[order], starts)).max(
        axis=1
    )
    several = np.bincount(piece, minlength=count) > 1
    many = (triangles[piece] > limit) & ~flat
    return np.asarray((many | (extent > reach)[piece]) & several[piece])


def _sides(places: Float, piece: Index) -> Index:
    """0 below the median along the longest side of each piece's bounds and 1 above, (P,)."""
    order = np.argsort(piece, kind="stable")
    starts = np.flatnonzero(np.diff(piece[order], prepend=-1))
    sizes = np.diff(starts, append=len(order))
    extent = np.maximum.reduceat(places[order], starts) - np.minimum.reduceat(places[order], starts)
    axis = np.repeat(extent.argmax(axis=1), sizes)
    along = places[order, axis]
    sorted_within = np.lexsort((along, np.repeat(np.arange(len(starts)), sizes)))
    rank = np.empty(len(order), np.int64)
    rank[sorted_within] = np.arange(len(order)) - np.repeat(starts, sizes)
    side = np.empty(len(order), np.int64)
    side[order] = rank >= np.repeat((sizes + 1) // 2, sizes)
    return side


def _crumbs(graph: _Graph, joined: Index, piece: Index, side: Index) -> Mask:
    """Polygons (P,) in a part of a half that is small, unless it is the half's largest."""
    count = len(piece)
    whole = side[joined[:, 0]] == side[joined[:, 1]]
    part = components(joined[whole], count)
    size = np.bincount(part, graph.weights, count)[part]
    half = 2 * piece + side
    largest, total = np.zeros(2 * count), np.bincount(half, graph.weights, 2 * count)
    np.maximum.at(largest, half, size)
    return np.asarray((size < CRUMB * total[half]) & (size < largest[half]))


def _without_creases(graph: _Graph, piece: Index) -> Generator[None, None, Index]:
    """``piece`` (P,) cut until none has both sides of an edge that keeps them apart: at each time
    the polygons that are nearer to the one side, over joined edges, and those nearer to the other.
    """
    apart, joined = graph.apart, graph.joined
    while True:
        joined = joined[piece[joined[:, 0]] == piece[joined[:, 1]]]
        apart = apart[piece[apart[:, 0]] == piece[apart[:, 1]]]
        if not len(apart):
            return piece
        cut, first = np.unique(piece[apart[:, 0]], return_index=True)
        of_cut = np.isin(piece[joined[:, 0]], cut)
        side = np.full(len(piece), -1)
        side[apart[first]] = (0, 1)
        _spread(side, joined[of_cut])
        whole = side[joined[:, 0]] == side[joined[:, 1]]
        piece = components(joined[whole], len(piece))
        yield


def _spread(side: Index, joined: Index) -> None:
    """Give every polygon that ``joined`` (E, 2) leads to the side (P,) of the nearest that has
    one, in place."""
    both = np.concatenate([joined, joined[:, ::-1]])
    while len(both):
        both = both[side[both[:, 1]] < 0]
        ready = both[side[both[:, 0]] >= 0]
        if not len(ready):
            return
        sides = side[ready[:, 0]]
        side[ready[sides == 1, 1]] = 1
        side[ready[sides == 0, 1]] = 0
