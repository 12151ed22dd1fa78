"""PNG of 8 or 16 bits a channel, by the standard library alone."""

import io
import struct
import zlib
from collections.abc import Mapping
from pathlib import Path
from typing import BinaryIO

import numpy as np
import numpy.typing as npt

SIGNATURE = b"\x89PNG\r\n\x1a\n"
MOST = 65535
COLOURS = {3: 2, 4: 6}  # PNG's numbers of the colour types RGB and RGBA
UP = 2  # and of the filter that keeps differences to the row above
ROWS = 64  # compressed at a time

Pixels = npt.NDArray[np.uint8] | npt.NDArray[np.uint16]


def write_png(path: Path, pixels: Pixels, texts: Mapping[str, str]) -> None:
    """Write ``pixels`` (H, W, 3 or 4), top row first, with ``texts`` in UTF-8 before them."""
    with path.open("wb") as file:
        _write(file, pixels, texts)


def png_bytes(pixels: Pixels) -> bytes:
    """The file of ``pixels`` (H, W, 3 or 4), top row first, that says nothing of colour spaces: so
    no reader has a reason to change a number."""
    file = io.BytesIO()
    _write(file, pixels, {})
    return file.getvalue()


def _write(file: BinaryIO, pixels: Pixels, texts: Mapping[str, str]) -> None:
    height, width, channels = pixels.shape
    depth, stride = 8 * pixels.itemsize, pixels.itemsize * channels * width
    file.write(SIGNATURE)
    header = struct.pack(">IIBBBBB", width, height, depth, COLOURS[channels], 0, 0, 0)
    _chunk(file, b"IHDR", header)
    for key, text in texts.items():
        _chunk(file, b"iTXt", key.encode("latin-1") + b"\0\0\0\0\0" + text.encode())
    packer = zlib.compressobj()
    above = np.zeros((1, stride), np.uint8)
    for start in range(0, height, ROWS):
        rows = pixels[start : start + ROWS].astype(pixels.dtype.newbyteorder(">"))
        flat = rows.view(np.uint8).reshape(len(rows), stride)
        lines = np.empty((len(flat), 1 + stride), np.uint8)
        lines[:, 0] = UP
        lines[:, 1:] = flat - np.concatenate([above, flat[:-1]])
        above = flat[-1:]
        if data := packer.compress(lines.tobytes()):
            _chunk(file, b"IDAT", data)
    _chunk(file, b"IDAT", packer.flush())
    _chunk(file, b"IEND", b"")


def _chunk(file: BinaryIO, kind: bytes, data: bytes) -> None:
    file.write(struct.pack(">I", len(data)) + kind + data)
    file.write(struct.pack(">I", zlib.crc32(kind + data)))
