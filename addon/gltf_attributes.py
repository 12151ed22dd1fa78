"""The attributes of one primitive of the exporter: which are ours, their values, their copies.

Nothing of the exporter's is changed in place: it keeps primitives for other objects that share the
mesh.
"""

from collections.abc import Iterator, Sequence
from copy import copy
from typing import Any

import numpy as np
import numpy.typing as npt

from .prt.layout import PREFIX

Accessors = dict[str, Any]

FLOAT, UNSIGNED_SHORT = 5126, 5123


def is_ours(name: str) -> bool:
    """Is ``name`` one of _PRT_0, _PRT_1, ..."""
    return name.startswith(PREFIX) and name[len(PREFIX) :].isdigit()


def bare(attributes: Accessors) -> Accessors:
    """All but ours."""
    return {name: accessor for name, accessor in attributes.items() if not is_ours(name)}


def read(attributes: Accessors, names: Sequence[str]) -> npt.NDArray[np.float32] | None:
    """Values (E, 4 k) of the float VEC4 attributes ``names``; None where one is missing."""
    accessors = [attributes.get(name) for name in names]
    if any(a is None or (a.component_type, a.type) != (FLOAT, "VEC4") for a in accessors):
        return None
    return np.concatenate([_values(accessor) for accessor in accessors], axis=1)


def replaced(
    attributes: Accessors, names: Sequence[str], values: npt.NDArray[np.float32]
) -> Accessors:
    """``attributes`` with exactly ``names`` of ours, holding ``values`` (E, 4 k)."""
    ours = {
        name: _with_data(attributes[name], values[:, 4 * k : 4 * k + 4].tobytes())
        for k, name in enumerate(names)
    }
    return bare(attributes) | ours


def without_our_colors(attributes: Accessors, names: Sequence[str], render: str) -> Accessors:
    """``attributes`` with the COLOR_n that the exporter would write if we were not there.

    Ours are colour attributes in Blender, so the exporter writes clipped copies of them.  ``names``
    are the mesh's colour attributes in order, ``render`` the default one of them.
    """
    colors = {name: a for name, a in attributes.items() if name.startswith("COLOR_")}
    written = [colors[name] for name in sorted(colors, key=lambda name: int(name[6:]))]
    if all(is_ours(name) for name in names):
        theirs = []
    else:
        order = _order(attributes, written, names, render)
        theirs = [a for a, name in zip(written, order, strict=False) if not is_ours(name)]
    others = {name: a for name, a in attributes.items() if name not in colors}
    return others | {f"COLOR_{n}": accessor for n, accessor in enumerate(theirs)}


def _order(
    attributes: Accessors, written: list[Any], names: Sequence[str], render: str
) -> list[str]:
    """The colour attribute that each of ``written`` came from."""
    for order in _possible_orders(names, render, len(written)):
        pairs = zip(written, order, strict=False)
        if all(_is_copy(a, attributes.get(name)) for a, name in pairs if is_ours(name)):
            return order
    return [name for name in names if not is_ours(name)]


def _possible_orders(names: Sequence[str], render: str, count: int) -> Iterator[list[str]]:
    """First comes the colour that the material reads, or a white one ("") where it reads none; the
    rest follow as they lie in the mesh."""
    if count > len(names):
        yield ["", *names]
    for first in sorted(names, key=lambda name: (name != render, is_ours(name))):
        yield [first, *(name for name in names if name != first)]


def _is_copy(color: Any, ours: Any) -> bool:
    """Did the exporter make ``color`` of our attribute?"""
    if ours is None:
        return False
    values = _values(ours)
    if color.component_type == UNSIGNED_SHORT:
        with np.errstate(invalid="ignore"):
            scaled = np.clip(values, 0, 1) * np.float32(65535) + np.float32(0.5)
            expected = scaled.astype(np.uint16)
    else:
        expected = values[:, :3]
    return bool(color.buffer_view.data == expected.tobytes())


def _values(accessor: Any) -> npt.NDArray[np.float32]:
    return np.frombuffer(accessor.buffer_view.data, np.float32).reshape(-1, 4)


def _with_data(accessor: Any, data: bytes) -> Any:
    """A copy of ``accessor`` over ``data``, uncompressed."""
    twin = copy(accessor)
    twin.buffer_view = type(accessor.buffer_view)(data, accessor.buffer_view.bufferViewTarget)
    return twin
