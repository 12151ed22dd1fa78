"""A reader of the PNGs that we write, by the standard library alone."""

import zlib

import numpy as np

CHANNELS = {2: 3, 6: 4}  # by PNG's number of the colour type
UP = 2


def chunks(data):
    """Kind and body of every chunk."""
    assert data[:8] == b"\x89PNG\r\n\x1a\n"
    place = 8
    while place < len(data):
        size, kind = int.from_bytes(data[place : place + 4]), data[place + 4 : place + 8]
        yield kind, data[place + 8 : place + 8 + size]
        place += 12 + size


def pixels_of(data):
    """Pixels (H, W, 3 or 4) of a PNG of 8 bits without a colour space."""
    found = list(chunks(data))
    assert {kind for kind, _ in found} == {b"IHDR", b"IDAT", b"IEND"}
    head = found[0][1]
    width, height = int.from_bytes(head[:4]), int.from_bytes(head[4:8])
    assert tuple(head[8:9] + head[10:]) == (8, 0, 0, 0)
    channels = CHANNELS[head[9]]
    packed = zlib.decompress(b"".join(body for kind, body in found if kind == b"IDAT"))
    lines = np.frombuffer(packed, np.uint8).reshape(height, 1 + channels * width)
    assert (lines[:, 0] == UP).all()
    return np.cumsum(lines[:, 1:], axis=0, dtype=np.uint8).reshape(height, width, channels)
