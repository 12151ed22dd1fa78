"""Receivers unwrapped into one atlas, in child processes."""

from collections.abc import Generator, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import numpy.typing as npt

from ..errors import BakeError
from ..job import Receiver
from ..surface.points import Float, Index, Surface
from .charting import Charts
from .children import ChildLostError, Children
from .messages import Arrays
from .packing import Packed, Packer
from .pieces import MAX_TRIANGLES, pieces_of
from .plane import are_needles

REACH = 0.75  # of the side of a square with the surface's area: no piece is longer
CUT, UNWRAPPED = 0.1, 0.75  # shares of the work that are done when these are

Array = npt.NDArray[Any]


@dataclass(frozen=True)
class Unwrapped:
    """An atlas of ``size`` x ``size`` texels, and for each receiver the UVs of its corners (C, 2)
    float32, in 0 .. 1."""

    size: int
    uvs: tuple[Array, ...]


@dataclass(frozen=True)
class _Cut:
    """All receivers' triangles that have an area to speak of: ``corners`` (F, 3, 3), ``vertices``
    (F, 3) and ``loops`` (F, 3), numbered through, the ``pieces`` (F,) and ``receivers`` (F,) that
    they are of."""

    corners: Float
    vertices: Index
    loops: Index
    pieces: Index
    receivers: Index


def unwrap(
    receivers: Sequence[Receiver], *, size: int, density: float, padding: int, threads: int
) -> Generator[float, None, Unwrapped]:
    """One atlas for all ``receivers``, with ``padding`` texels between charts: ``size`` x ``size``,
    or, where ``size`` is 0, the smallest power of two that holds them at ``density`` texels a unit.

    Yields the share done, every second or so; ``close()`` kills the children, of which there are
    ``threads``, 0 for one a core.  The same receivers give the same bytes, whatever ``threads`` is.
    BakeError where there is nothing to unwrap, or no room for it.
    """
    yield 0.0
    cut = yield from _cut(receivers)
    children = Children(threads)
    try:
        charts = yield from _charts(cut, receivers, children)
        packer = Packer(charts, padding, children)
        steps = packer.into(size) if size else packer.at(density)
        while True:
            try:
                done = next(steps)
            except StopIteration as stop:
                packed = stop.value
                break
            yield UNWRAPPED + (1 - UNWRAPPED) * done
    finally:
        children.close()
    return Unwrapped(packed.size, tuple(_corner_uvs(receivers, cut, packed)))


def _cut(receivers: Sequence[Receiver]) -> Generator[float, None, _Cut]:
    """The pieces of all receivers."""
    surfaces = [_surface(receiver) for receiver in receivers]
    reach = REACH * float(np.sqrt(sum(surface.areas.sum() for surface in surfaces)))
    parts: list[_Cut] = []
    vertices = loops = pieces = 0
    for number, (receiver, surface) in enumerate(zip(receivers, surfaces, strict=True)):
        solid = surface.solid & ~are_needles(surface.corners)
        sound = replace(
            receiver,
            triangles=receiver.triangles[solid],
            triangle_corners=receiver.triangle_corners[solid],
        )
        steps, done = pieces_of(sound, reach), CUT * number / len(receivers)
        while True:
            try:
                next(steps)
            except StopIteration as stop:
                found = stop.value
                break
            yield done
        parts.append(
            _Cut(
                surface.corners[solid],
                found.positions[sound.triangles] + vertices,
                sound.triangle_corners.astype(np.int64) + loops,
                found.of_triangles + pieces,
                np.full(len(sound.triangles), number),
            )
        )
        vertices += len(receiver.vertices)
        loops += len(receiver.corner_vertices)
        pieces += found.count
    return _Cut(*(np.concatenate(arrays) for arrays in zip(*map(_fields, parts), strict=True)))


def _fields(cut: _Cut) -> list[Array]:
    return list(vars(cut).values())


def _surface(receiver: Receiver) -> Surface:
    """The triangles of ``receiver``; BakeError where none can be unwrapped."""
    if not np.isfinite(np.asarray(receiver.vertices)[receiver.triangles]).all():
        raise BakeError(
            f"Object {receiver.name!r} has vertices that are NaN or infinite: delete or move them"
        )
    surface = Surface.of(receiver)
    if are_needles(surface.corners).all():
        raise BakeError(
            f"Object {receiver.name!r} has only faces without area: use Mesh > Clean Up"
        )
    return surface


def _charts(
    cut: _Cut, receivers: Sequence[Receiver], children: Children
) -> Generator[float, None, Charts]:
    """Charts of all pieces."""
    order = np.argsort(cut.pieces, kind="stable")
    sizes = np.bincount(cut.pieces)
    batch = ((np.cumsum(sizes) - sizes) // MAX_TRIANGLES)[cut.pieces[order]]
    groups = np.split(order, np.flatnonzero(np.diff(batch)) + 1)
    steps = children.answers([_task(cut, group) for group in groups])
    while True:
        try:
            done = next(steps)
        except StopIteration as stop:
            return _joined(stop.value, groups)
        except ChildLostError as lost:
            name = receivers[cut.receivers[groups[lost.number][0]]].name
            raise BakeError(
                f"Object {name!r} cannot be unwrapped: use Mesh > Clean Up, or give it a UV map"
            ) from lost
        yield CUT + (UNWRAPPED - CUT) * done / len(groups)


def _task(cut: _Cut, group: Index) -> Arrays:
    """Some of the triangles, their vertices numbered anew."""
    _, first, triangles = np.unique(cut.vertices[group], return_index=True, return_inverse=True)
    return {
        "vertices": cut.corners[group].reshape(-1, 3)[first],
        "triangles": triangles.reshape(-1, 3),
        "loops": cut.loops[group],
        "pieces": cut.pieces[group],
    }


def _joined(answers: list[Arrays], groups: list[Index]) -> Charts:
    """The charts of all ``groups``, numbered through, in the order of the triangles."""
    uvs, vertices, charts = 0, [], []
    count = 0
    for answer in answers:
        vertices.append(answer["triangles"] + uvs)
        charts.append(answer["charts"] + count)
        uvs += len(answer["uvs"])
        count += int(answer["charts"].max()) + 1
    back = np.argsort(np.concatenate(groups))
    return Charts(
        np.concatenate([answer["uvs"] for answer in answers]),
        np.concatenate(vertices)[back],
        np.concatenate(charts)[back],
    )


def _corner_uvs(
    receivers: Sequence[Receiver], cut: _Cut, packed: Packed
) -> Generator[Array, None, None]:
    """The UVs of each receiver's corners; those of no triangle with an area lie where another
    corner of their triangle does, so that it covers nothing."""
    start = 0
    for number, receiver in enumerate(receivers):
        own = cut.receivers == number
        count = len(receiver.corner_vertices)
        uvs, known = np.zeros((count, 2), np.float32), np.zeros(count, bool)
        loops = (cut.loops[own] - start).reshape(-1)
        uvs[loops], known[loops] = packed.uvs[own].reshape(-1, 2), True
        corners = np.asarray(receiver.triangle_corners)
        lost = corners[~known[corners].all(axis=1)]
        some = np.take_along_axis(lost, known[lost].argmax(axis=1)[:, None], axis=1)
        for k in range(3):
            missing = ~known[lost[:, k]]
            uvs[lost[missing, k]] = uvs[some[missing, 0]]
        start += count
        yield uvs
