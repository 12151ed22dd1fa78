"""Arrays through a pipe: a line of JSON that names them, then their bytes."""

import json
from collections.abc import Mapping
from typing import Any, BinaryIO

import numpy as np
import numpy.typing as npt

Arrays = dict[str, npt.NDArray[Any]]


def send(stream: BinaryIO, arrays: Mapping[str, npt.NDArray[Any]]) -> None:
    """Write ``arrays`` to ``stream``."""
    whole = {name: np.ascontiguousarray(array) for name, array in arrays.items()}
    header = [(name, array.dtype.str, array.shape) for name, array in whole.items()]
    stream.write(json.dumps(header).encode() + b"\n")
    stream.writelines(array.tobytes() for array in whole.values())
    stream.flush()


def receive(stream: BinaryIO) -> Arrays | None:
    """The next arrays from ``stream``; None where it has ended."""
    line = stream.readline()
    if not line.endswith(b"\n"):
        return None
    arrays: Arrays = {}
    for name, kind, shape in json.loads(line):
        dtype, count = np.dtype(kind), int(np.prod(shape))
        data = stream.read(count * dtype.itemsize)
        if len(data) < count * dtype.itemsize:
            return None
        arrays[name] = np.frombuffer(data, dtype).reshape(shape)
    return arrays
