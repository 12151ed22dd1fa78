"""The attributes of one primitive of the exporter: which are ours, their values, their copies.

Nothing of the exporter's is changed in place: it keeps primitives for other objects that share the
mesh.
"""

from collections.abc import Sequence
from copy import copy
from typing import Any

import numpy as np
import numpy.typing as npt

from .prt.layout import PREFIX

Accessors = dict[str, Any]

FLOAT = 5126


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
    return np.concatenate([values_of(accessor) for accessor in accessors], axis=1)


def replaced(
    attributes: Accessors, names: Sequence[str], values: npt.NDArray[np.float32]
) -> Accessors:
    """``attributes`` with exactly ``names`` of ours, holding ``values`` (E, 4 k)."""
    ours = {
        name: _with_data(attributes[name], values[:, 4 * k : 4 * k + 4].tobytes())
        for k, name in enumerate(names)
    }
    return bare(attributes) | ours


def values_of(accessor: Any) -> npt.NDArray[np.float32]:
    """Values (E, 4) of a float VEC4."""
    return np.frombuffer(accessor.buffer_view.data, np.float32).reshape(-1, 4)


def _with_data(accessor: Any, data: bytes) -> Any:
    """A copy of ``accessor`` over ``data``, uncompressed."""
    twin = copy(accessor)
    twin.buffer_view = type(accessor.buffer_view)(data, accessor.buffer_view.bufferViewTarget)
    return twin
