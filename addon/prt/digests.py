"""Hashes of arrays and files, the same on every machine."""

import hashlib
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt


def add_array(digest: "hashlib.blake2b", name: str, array: npt.NDArray[Any]) -> None:
    """Let ``digest`` depend on ``array``, its type and shape."""
    digest.update(f"{name} {array.shape} {array.dtype}".encode())
    digest.update(np.ascontiguousarray(array))


def add_files(digest: "hashlib.blake2b", path: str | None) -> None:
    """Let ``digest`` depend on what the file at ``path`` holds, which may be missing, or on all
    files of a folder; not on where that lies."""
    for file in _files(Path(path)) if path else ():
        with file.open("rb") as content:
            digest.update(hashlib.file_digest(content, "blake2b").digest())


def _files(path: Path) -> list[Path]:
    if path.is_dir():
        return sorted(file for file in path.iterdir() if file.is_file())
    return [path] if path.exists() else []
