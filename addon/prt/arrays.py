"""Arrays of one kind, one after the other in a .npy: a scene of many small things is then a few
files, whose making takes longer than what is in them."""

from collections.abc import Sequence
from math import prod
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[Any]
Shape = Sequence[int]


def write_all(path: Path, arrays: Sequence[Array]) -> list[Shape]:
    """Write ``arrays`` of any shapes into ``path``; the shapes, which ``read_all`` asks for."""
    kinds = {array.dtype for array in arrays} or {np.dtype(np.float32)}
    dtype = np.result_type(*kinds)
    shapes: list[Shape] = [array.shape for array in arrays]
    header = {"descr": dtype.str, "fortran_order": False, "shape": (sum(map(prod, shapes)),)}
    with path.open("wb") as file:
        np.lib.format.write_array_header_1_0(file, header)
        for array in arrays:
            np.ascontiguousarray(array, dtype).tofile(file)
    return shapes


def read_all(path: Path, shapes: Sequence[Shape], mapped: bool = False) -> list[Array]:
    """The arrays of ``path``, of these ``shapes``; views of one, which may be memory-mapped."""
    ends = np.cumsum([prod(shape) for shape in shapes], dtype=np.int64)
    may_map = mapped and len(ends) and ends[-1] > 0  # nothing cannot be mapped
    apart = np.split(np.asarray(np.load(path, mmap_mode="r" if may_map else None)), ends)
    return [flat.reshape(shape) for flat, shape in zip(apart, shapes, strict=False)]
