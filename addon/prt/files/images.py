"""Pictures of light on disk: .exr and .hdr.  The only module that imports OpenEXR.

Pixels are linear Rec.709 radiance, (H, W, 3) float32, top row first.  As in Blender, an .exr's data
window is the picture, whatever its display window.
"""

import os
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from ..errors import BakeError
from . import rgbe

Pixels = npt.NDArray[np.float32]
MAX_PIXELS = 1 << 29  # 32768 x 16384; a header that claims more is damaged
LARGEST_HALF = 65504.0
EXR_MAGIC = b"\x76\x2f\x31\x01"
HDR_MAGIC = b"#?"
# How C++'s exceptions arrive, and text that is not UTF-8
EXR_ERRORS = (RuntimeError, ValueError, TypeError, LookupError, ArithmeticError, MemoryError)


def read(path: str) -> Pixels:
    """The pixels (H, W, 3) of an .exr or .hdr file, known by its content and not by its name.

    BakeError, naming the file, for everything that is not one whole picture.
    """
    try:
        with Path(path).open("rb") as file:
            magic = file.read(4)
            if magic[:2] == HDR_MAGIC:
                return _read_hdr(path, magic + file.read())
    except (OSError, ValueError) as error:
        reason = error.strerror if isinstance(error, OSError) else error
        raise BakeError(f"The picture {path} cannot be read: {reason}") from error
    if not magic:
        raise BakeError(f"The picture {path} is empty")
    if magic != EXR_MAGIC:
        raise BakeError(f"The picture {path} is neither OpenEXR nor Radiance HDR")
    return _read_exr(path)


def write_exr(path: str, pixels: npt.ArrayLike, metadata: Mapping[str, str] | None = None) -> None:
    """Write pixels (H, W, 3) as float32 R, G, B, with ``metadata`` as attributes in the header."""
    import OpenEXR

    header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
    channels = {"RGB": np.ascontiguousarray(pixels, np.float32)}
    try:
        OpenEXR.File(header | dict(metadata or {}), channels).write(path)
    except EXR_ERRORS as error:
        raise BakeError(f"The picture {path} cannot be written") from error


def write_rgba(
    path: str, pixels: Pixels, *, half: bool = False, metadata: Mapping[str, str] | None = None
) -> None:
    """Write pixels (H, W, 4), top row first, as R, G, B, A of float32 or ``half`` floats, with
    ``metadata`` as attributes in the header.  OSError where there is no room."""
    import OpenEXR

    OpenEXR.set_global_thread_count(os.cpu_count() or 1)
    header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
    kind = np.float16 if half else np.float32
    if half:
        pixels = np.clip(pixels, -LARGEST_HALF, LARGEST_HALF)
    channels = {"RGBA": np.ascontiguousarray(pixels, kind)}
    try:
        OpenEXR.File(header | dict(metadata or {}), channels).write(path)
    except EXR_ERRORS as error:
        raise OSError(f"{path} cannot be written") from error


def read_rgba(path: str) -> tuple[Pixels, dict[str, str]]:
    """The pixels (H, W, 4) float32, top row first, that ``write_rgba`` wrote, and the header's
    texts.  BakeError where the file is not one of these."""
    import OpenEXR

    try:
        (part,) = OpenEXR.File(path).parts
        texts = {k: v for k, v in part.header.items() if isinstance(v, str)}
        return np.asarray(part.channels["RGBA"].pixels, np.float32), texts
    except EXR_ERRORS as error:
        raise BakeError(f"The picture {path} is damaged or none of ours") from error


def _read_hdr(path: str, data: bytes) -> Pixels:
    try:
        return rgbe.decode(data, MAX_PIXELS)
    except rgbe.RgbeError as error:
        raise BakeError(f"The picture {path} {error}") from error


def _read_exr(path: str) -> Pixels:
    """Header first, so that a bogus size is refused before memory is taken for it."""
    import OpenEXR

    OpenEXR.set_global_thread_count(os.cpu_count() or 1)
    try:
        parts = OpenEXR.File(path, header_only=True).parts
        part, names = _colour_channels(path, [part.header for part in parts])
        shape = _shape(path, parts[part].header)
        if len(parts) == 1 and sorted(_names(parts[0].header)) == ["B", "G", "R"]:
            pixels = _interleaved(path)
            if pixels is not None and pixels.shape == (*shape, 3):
                return pixels
        read_parts = OpenEXR.File(path, separate_channels=True).parts
        # parts that could not be decoded are left out without an exception
        if len(read_parts) != len(parts):
            raise BakeError(f"The picture {path} is damaged or cut off")
        channels = [read_parts[part].channels[name].pixels for name in names]
    except EXR_ERRORS as error:
        raise BakeError(f"The picture {path} is damaged or cut off") from error
    if any(channel.shape != shape for channel in channels):
        raise BakeError(f"The picture {path} has colours of different sizes: save it as plain RGB")
    pixels = np.empty((*shape, 3), np.float32)
    for k, channel in enumerate(channels):
        pixels[..., k] = channel
    return pixels


def _interleaved(path: str) -> Pixels | None:
    """What OpenEXR itself puts side by side, which is faster; None where it doesn't."""
    import OpenEXR

    try:
        (part,) = OpenEXR.File(path).parts
        return np.asarray(part.channels["RGB"].pixels, np.float32)
    except EXR_ERRORS:  # colours of different types or sizes, or damage, which is found again
        return None


def _shape(path: str, header: Mapping[str, Any]) -> tuple[int, int]:
    """Height and width of the data window."""
    low, high = (corner.astype(np.int64) for corner in header["dataWindow"])
    width, height = (int(size) for size in high - low + 1)
    if width <= 0 or height <= 0 or width * height > MAX_PIXELS:
        raise BakeError(f"The picture {path} claims to have {width} x {height} pixels")
    return height, width


def _colour_channels(
    path: str, headers: list[Mapping[str, Any]]
) -> tuple[int, tuple[str, str, str]]:
    """The part to read and its channels of red, green and blue.

    Colour before grey; then channels without a layer, a layer Combined (Blender's), the first.
    """
    found = [
        (grey, _rank(layer), part, names)
        for part, header in enumerate(headers)
        for grey, layer, names in _candidates(_names(header))
        if "deep" not in str(header.get("type"))
    ]
    if not found:
        raise BakeError(f"The picture {path} has no channels R, G and B, nor Y alone, to read")
    _, _, part, names = min(found)
    return part, names


def _names(header: Mapping[str, Any]) -> list[str]:
    return [channel.name for channel in header["channels"]]


def _candidates(names: list[str]) -> Iterator[tuple[bool, str, tuple[str, str, str]]]:
    """Whether grey, layer, and the three channels, for every layer that has colour or grey."""
    for layer in dict.fromkeys(name.rpartition(".")[0] for name in names):
        prefix = f"{layer}." if layer else ""
        if all(prefix + colour in names for colour in "RGB"):
            yield False, layer, (prefix + "R", prefix + "G", prefix + "B")
        elif prefix + "Y" in names and prefix + "RY" not in names:
            yield True, layer, (prefix + "Y",) * 3


def _rank(layer: str) -> int:
    if not layer:
        return 0
    return 1 if layer.rpartition(".")[2] == "Combined" else 2
