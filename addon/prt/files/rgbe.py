"""Radiance .hdr pictures: shared-exponent pixels, flat or run-length encoded.

Greg Ward, Real Pixels (Graphics Gems II), and his color.c for the two run-length encodings.  Like
Blender, no EXPOSURE is applied and no half step added to the mantissas.
"""

import re

import numpy as np
import numpy.typing as npt

Bytes = npt.NDArray[np.uint8]
Float32 = npt.NDArray[np.float32]
RESOLUTION = re.compile(rb"-Y (\d{1,9}) \+X (\d{1,9})")


class RgbeError(ValueError):
    """What is wrong with the picture, to stand after its name: "is cut off"."""


def decode(data: bytes, max_pixels: int) -> Float32:
    """The pixels (H, W, 3) of a .hdr file's bytes, top row first; RgbeError for what it is not."""
    height, width, place = _header(data)
    if not 0 < height * width <= max_pixels:
        raise RgbeError(f"claims to have {width} x {height} pixels")
    rows = bytearray()
    planar = []
    for _ in range(height):
        packed = _is_packed(data, place, width)
        planar.append(packed)
        row, place = (_packed_row if packed else _flat_row)(data, place, width)
        rows += row
    return _to_float(np.frombuffer(rows, np.uint8).reshape(height, -1), np.array(planar))


def _header(data: bytes) -> tuple[int, int, int]:
    """Height, width, and where the pixels begin."""
    end = data.find(b"\n\n")
    line_end = data.find(b"\n", end + 2)
    if end < 0 or line_end < 0:
        raise RgbeError("is cut off")
    if b"FORMAT=32-bit_rle_xyze" in data[:end]:
        raise RgbeError("holds XYZ colours: save it as RGB")
    resolution = RESOLUTION.fullmatch(data[end + 2 : line_end].strip())
    if resolution is None:
        raise RgbeError("is damaged or does not begin with its top row, left to right")
    return int(resolution[1]), int(resolution[2]), line_end + 1


def _is_packed(data: bytes, place: int, width: int) -> bool:
    """Whether the row at ``place`` has its four planes run-length encoded one by one."""
    return (
        8 <= width < 32768
        and data[place : place + 2] == b"\x02\x02"
        and int.from_bytes(data[place + 2 : place + 4], "big") == width
    )


def _packed_row(data: bytes, place: int, width: int) -> tuple[bytearray, int]:
    """The planes (4 W bytes) of a packed row, and where the next row begins."""
    row = bytearray()
    place += 4
    for plane in range(1, 5):
        while len(row) < plane * width:
            count = data[place] if place + 1 < len(data) else 0
            if count > 128:
                row += data[place + 1 : place + 2] * (count - 128)
                place += 2
            else:
                row += data[place + 1 : place + 1 + count]
                place += 1 + count
            if not count or place > len(data):
                raise RgbeError("is cut off")
        if len(row) != plane * width:
            raise RgbeError("is damaged")
    return row, place


def _flat_row(data: bytes, place: int, width: int) -> tuple[bytes | bytearray, int]:
    """The pixels (4 W bytes) of a row that is flat or has the old repeats, and where it ends."""
    row = data[place : place + 4 * width]
    mantissas = np.frombuffer(row[: len(row) // 4 * 4], np.uint8).reshape(-1, 4)[:, :3]
    if (mantissas == 1).all(axis=1).any():
        return _old_row(data, place, width)
    if len(row) < 4 * width:
        raise RgbeError("is cut off")
    return row, place + 4 * width


def _old_row(data: bytes, place: int, width: int) -> tuple[bytearray, int]:
    """A row in which (1, 1, 1, n) repeats the pixel before it; again and again for more digits."""
    row, shift = bytearray(), 0
    while len(row) < 4 * width:
        pixel = data[place : place + 4]
        if len(pixel) < 4:
            raise RgbeError("is cut off")
        place += 4
        if pixel[:3] != b"\x01\x01\x01":
            row += pixel
            shift = 0
            continue
        repeats = pixel[3] << shift
        if not row or len(row) + 4 * repeats > 4 * width:
            raise RgbeError("is damaged")
        row += row[-4:] * repeats
        shift += 8
    return row, place


def _to_float(rows: Bytes, planar: npt.NDArray[np.bool_]) -> Float32:
    """Pixels (H, W, 3) from rows (H, 4 W) of planes, where ``planar``, or of whole pixels."""
    height, width = len(rows), rows.shape[1] // 4
    pixels = np.empty((height, width, 3), np.float32)
    for y in range(height):
        channels = rows[y].reshape(4, width).T if planar[y] else rows[y].reshape(width, 4)
        pixels[y] = np.ldexp(channels[:, :3].astype(np.float32), channels[:, 3:].astype(int) - 136)
        pixels[y, channels[:, 3] == 0] = 0
    return pixels
