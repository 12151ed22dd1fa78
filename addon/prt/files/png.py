"""PNG of 16 bits a channel, by the standard library alone."""

import struct
import zlib
from collections.abc import Mapping
from pathlib import Path
from typing import BinaryIO

import numpy as np
import numpy.typing as npt

SIGNATURE = b"\x89PNG\r\n\x1a\n"
MOST = 65535
RGBA, UP = 6, 2  # PNG's numbers of the colour type, and of the filter that keeps differences
ROWS = 64  # compressed at a time


def write_png(path: Path, pixels: npt.NDArray[np.uint16], texts: Mapping[str, str]) -> None:
    """Write ``pixels`` (H, W, 4), top row first, with ``texts`` in UTF-8 before them."""
    height, width, _ = pixels.shape
    with path.open("wb") as file:
        file.write(SIGNATURE)
        _chunk(file, b"IHDR", struct.pack(">IIBBBBB", width, height, 16, RGBA, 0, 0, 0))
        for key, text in texts.items():
            _chunk(file, b"iTXt", key.encode("latin-1") + b"\0\0\0\0\0" + text.encode())
        packer = zlib.compressobj()
        above = np.zeros((1, 8 * width), np.uint8)
        for start in range(0, height, ROWS):
            rows = pixels[start : start + ROWS].astype(">u2").view(np.uint8)
            rows = rows.reshape(len(rows), 8 * width)
            lines = np.empty((len(rows), 1 + 8 * width), np.uint8)
            lines[:, 0] = UP
            lines[:, 1:] = rows - np.concatenate([above, rows[:-1]])
            above = rows[-1:]
            if data := packer.compress(lines.tobytes()):
                _chunk(file, b"IDAT", data)
        _chunk(file, b"IDAT", packer.flush())
        _chunk(file, b"IEND", b"")


def _chunk(file: BinaryIO, kind: bytes, data: bytes) -> None:
    file.write(struct.pack(">I", len(data)) + kind + data)
    file.write(struct.pack(">I", zlib.crc32(kind + data)))
