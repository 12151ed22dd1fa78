"""The attributes of one primitive of the exporter: which are ours, their values, their copies.

Nothing of the exporter's is changed in place: it keeps primitives for other objects that share the
mesh.
"""

from collections.abc import Iterable, Sequence
from copy import copy
from typing import Any

import numpy as np
import numpy.typing as npt

from .prt.layout import DIRECT, PREFIX

Accessors = dict[str, Any]

VERSION = 1  # of the schema, docs/gltf.md
BASIS = "real orthonormal, no Condon-Shortley, l(l+1)+m"
INCLUDES = "visibility, cosine / pi"
BOUNCES = ", bounces"  # after that, where light of other surfaces is inside too

FLOAT, SHORT = 5126, 5122
LARGEST = 32767  # of a normalized SHORT, which stands for 1


def is_ours(name: str) -> bool:
    """Is ``name`` one of _PRT_0, _PRT_1, ... or _PRT_DIRECT_0, ..."""
    return name.removeprefix(DIRECT).isdigit() or name.removeprefix(PREFIX).isdigit()


def bare(attributes: Accessors) -> Accessors:
    """All but ours."""
    return {name: accessor for name, accessor in attributes.items() if not is_ours(name)}


def read(attributes: Accessors, names: Sequence[str]) -> npt.NDArray[np.float32] | None:
    """Values (E, 4 k) of the float VEC4 attributes ``names``; None where one is missing."""
    accessors = [attributes.get(name) for name in names]
    if any(a is None or (a.component_type, a.type) != (FLOAT, "VEC4") for a in accessors):
        return None
    return np.concatenate([values_of(accessor) for accessor in accessors], axis=1)


def holding(attributes: Accessors, names: Sequence[str], stored: npt.NDArray[Any]) -> Accessors:
    """Those of ``attributes`` that are called ``names``, holding what is ``stored`` (E, 4 k),
    float32 or int16, which become normalized SHORT."""
    return {
        name: _with_data(attributes[name], stored[:, 4 * k : 4 * k + 4])
        for k, name in enumerate(names)
    }


def scale_of(parts: Iterable[npt.NDArray[np.float32]]) -> npt.NDArray[np.float64]:
    """The scale (4 k) of ``parts`` (E, 4 k) each: the largest magnitude of every float."""
    return np.max([np.abs(values).max(axis=0, initial=0) for values in parts], axis=0).astype(float)


def quantized(
    values: npt.NDArray[np.float32], scale: npt.NDArray[np.float64]
) -> npt.NDArray[np.int16]:
    """``values`` (E, 4 k), no larger than ``scale`` (4 k), as normalized SHORT; off by at most
    ``scale / 65534``."""
    shares = np.zeros(values.shape)
    np.divide(values, scale, out=shares, where=scale > 0)
    return np.rint(LARGEST * shares).astype(np.int16)


def values_of(accessor: Any) -> npt.NDArray[np.float32]:
    """Values (E, 4) of a float VEC4."""
    return np.frombuffer(accessor.buffer_view.data, np.float32).reshape(-1, 4)


def _with_data(accessor: Any, values: npt.NDArray[Any]) -> Any:
    """A copy of ``accessor`` over ``values`` (E, 4), float32 or int16."""
    twin = copy(accessor)
    target = accessor.buffer_view.bufferViewTarget
    twin.buffer_view = type(accessor.buffer_view)(values.tobytes(), target)
    if values.dtype == np.int16:
        twin.component_type, twin.normalized = type(accessor.component_type)(SHORT), True
    return twin
