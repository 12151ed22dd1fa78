"""An atlas for programs that read no tiles: an image for every four columns.

``STEM_0.exr`` holds columns 0 .. 3 as red, green, blue and alpha, ``STEM_1.exr`` the next four; or
``STEM_0.png`` and so on, of 16 bits, with ``STEM.json`` that says what to make of them.  The top
row is the first in a file, and the last of ``image`` (N, N, K).  All files are written under other
names and then renamed, so that they are there whole or not at all.
"""

import json
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from ..errors import BakeError
from .images import write_rgba
from .png import MOST, write_png

Array = npt.NDArray[np.float32]
COLUMNS = "prtColumns"  # the attribute, in all of these files, that names their columns
HEADER = 1 << 16  # bytes in which it stands
FORMULA = f"value = offset + scale * pixel / {MOST}"


def write_layers(
    folder: Path,
    stem: str,
    image: Array,
    names: Sequence[str],
    *,
    half: bool,
    metadata: Mapping[str, str],
) -> list[Path]:
    """Write ``image`` (N, N, K), row 0 at the bottom, whose columns are called ``names``, as EXR of
    float32 or ``half`` floats; ``metadata`` stands in every header.  The files' paths.

    BakeError where they can't be written or a file is in the way that is none of ours.
    """
    files = [f"{stem}_{k}.exr" for k in range(-(-len(names) // 4))]
    with _whole(folder, files) as paths:
        for k, path in enumerate(paths):
            columns = {COLUMNS: " ".join(names[4 * k : 4 * k + 4])}
            pixels = _four(image, k)
            write_rgba(str(path), pixels, half=half, metadata={**metadata, **columns})
    return [folder / name for name in files]


def write_png16(
    folder: Path, stem: str, image: Array, names: Sequence[str], *, metadata: Mapping[str, str]
) -> dict[str, Any]:
    """Write ``image`` as ``write_layers`` does, finite, as PNG of 16 bits: each column's range in
    65,536 steps.  What ``STEM.json`` says: the formula, and for each file in turn its columns with
    their scale and offset, the largest error, and that error relative to the column's RMS.
    """
    count = -(-len(names) // 4)
    files = [f"{stem}_{k}.png" for k in range(count)]
    images = []
    with _whole(folder, [*files, f"{stem}.json"]) as paths:
        for k in range(count):
            four = _four(image, k)
            pixels, said = _in_steps(four, len(names[4 * k : 4 * k + 4]))
            columns = list(names[4 * k : 4 * k + 4])
            write_png(paths[k], pixels, {**metadata, COLUMNS: " ".join(columns)})
            images.append({COLUMNS: columns, **said})
        whole = {"version": 1, "formula": FORMULA, "images": images, "metadata": dict(metadata)}
        paths[-1].write_text(json.dumps(whole, indent=1), encoding="utf-8")
    return whole


def _four(image: Array, k: int) -> Array:
    """Columns 4 k .. 4 k + 3 of ``image``, top row first, 0 where there are none."""
    some = image[::-1, :, 4 * k : 4 * k + 4]
    pixels = np.zeros((*image.shape[:2], 4), np.float32)
    pixels[..., : some.shape[2]] = some
    return pixels


def _in_steps(pixels: Array, used: int) -> tuple[npt.NDArray[np.uint16], dict[str, list[float]]]:
    """Steps (H, W, 4) between the least and the greatest of each channel, and what they mean."""
    flat = pixels.reshape(-1, 4).astype(np.float64)
    offset, scale = flat.min(axis=0), np.ptp(flat, axis=0)
    steps = np.rint((flat - offset) / np.where(scale > 0, scale, 1) * MOST)
    error = np.abs(offset + scale * steps / MOST - flat).max(axis=0)
    rms = np.sqrt(np.square(flat).mean(axis=0))
    said = {
        "scale": scale,
        "offset": offset,
        "largest_error": error,
        "relative_error": error / np.where(rms > 0, rms, 1),
    }
    values = {name: [float(value) for value in of[:used]] for name, of in said.items()}
    return steps.astype(np.uint16).reshape(pixels.shape), values


@contextmanager
def _whole(folder: Path, names: Sequence[str]) -> Iterator[list[Path]]:
    """Paths to write, which become ``names`` in ``folder`` at the end, all or none."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
        for name in names:
            _check_free(folder / name)
        with tempfile.TemporaryDirectory(dir=folder, prefix=".prt-") as unfinished:
            paths = [Path(unfinished) / name for name in names]
            yield paths
            for path, name in zip(paths, names, strict=True):
                path.replace(folder / name)
    except OSError as error:
        raise BakeError(
            f"The folder {folder} cannot be written ({_reason(error)}): make room there, or "
            "choose another one"
        ) from error


def _reason(error: OSError) -> str:
    """Why; OpenEXR has a sentence for where, and another one for it."""
    return error.strerror or str(error.__cause__ or error).rstrip(".").rpartition(". ")[2]


def _check_free(path: Path) -> None:
    """BakeError where something is at ``path`` that is not one of our files."""
    if path.is_dir():
        raise BakeError(f"{path} is a folder: choose another name")
    if path.exists():
        with path.open("rb") as file:
            if COLUMNS.encode() not in file.read(HEADER):
                raise BakeError(f"{path} is no bake of ours: choose another name or move it away")
