"""Images for engines read back as what was written; what fails leaves nothing behind."""

import json
import subprocess
import sys
import zlib

import numpy as np
import OpenEXR
import pytest
from prt_baker.addon.prt.errors import BakeError
from prt_baker.addon.prt.files.layers import write_layers, write_png16

NAMES = ["T0", "T1", "T2", "T3", "R0r", "R0g", "R0b"]
META = {"prtBaker": "1.0", "stamp": "größer"}


@pytest.fixture
def image():
    values = np.random.default_rng(0).standard_normal((16, 16, len(NAMES))).astype(np.float32)
    values[..., 2] = 0.25  # constant
    values[..., 3] *= 1e-6
    return values


def read_exr(path):
    part = OpenEXR.File(str(path)).parts[0]
    return part.channels["RGBA"].pixels, part.header


def read_png(path):
    """Pixels (H, W, 4) of a PNG of 16 bits, and its texts."""
    data, place, packed, texts = path.read_bytes(), 8, b"", {}
    assert data[:8] == b"\x89PNG\r\n\x1a\n"
    while place < len(data):
        size, kind = int.from_bytes(data[place : place + 4]), data[place + 4 : place + 8]
        body = data[place + 8 : place + 8 + size]
        assert zlib.crc32(kind + body) == int.from_bytes(data[place + 8 + size : place + 12 + size])
        if kind == b"IHDR":
            width, height = (int.from_bytes(body[k : k + 4]) for k in (0, 4))
            assert body[8:] == b"\x10\x06\0\0\0"
        elif kind == b"IDAT":
            packed += body
        elif kind == b"iTXt":
            key, _, text = body.partition(b"\0")
            texts[key.decode()] = text[4:].decode()
        place += 12 + size
    lines = np.frombuffer(zlib.decompress(packed), np.uint8).reshape(height, 1 + 8 * width)
    assert (lines[:, 0] == 2).all()
    rows = np.cumsum(lines[:, 1:], axis=0, dtype=np.uint64).astype(np.uint8)
    return np.ascontiguousarray(rows).view(">u2").reshape(height, width, 4), texts


@pytest.mark.parametrize("half", [False, True])
def test_exr_reads_back_equal_with_the_top_row_first(tmp_path, image, half):
    paths = write_layers(tmp_path / "new", "wall", image, NAMES, half=half, metadata=META)
    assert [path.name for path in paths] == ["wall_0.exr", "wall_1.exr"]
    assert sorted(path.name for path in (tmp_path / "new").iterdir()) == [
        "wall_0.exr",
        "wall_1.exr",
    ]
    stored = image.astype(np.float16) if half else image
    for k, path in enumerate(paths):
        pixels, header = read_exr(path)
        some = stored[::-1, :, 4 * k : 4 * k + 4]
        assert pixels.dtype == stored.dtype
        np.testing.assert_array_equal(pixels[..., : some.shape[2]], some)
        assert not pixels[..., some.shape[2] :].any()
        assert header["prtColumns"] == " ".join(NAMES[4 * k : 4 * k + 4])
        assert header["stamp"] == META["stamp"]


def test_png_holds_what_its_json_says_to_its_error(tmp_path, image):
    said = write_png16(tmp_path, "wall", image, NAMES, metadata=META)
    assert json.loads((tmp_path / "wall.json").read_text("utf-8")) == said
    seen = []
    for k, entry in enumerate(said["images"]):
        pixels, texts = read_png(tmp_path / f"wall_{k}.png")
        assert texts == {**META, "prtColumns": " ".join(entry["prtColumns"])}
        for c, name in enumerate(entry["prtColumns"]):
            value = entry["offset"][c] + entry["scale"][c] * pixels[..., c] / 65535
            truth = image[::-1, :, NAMES.index(name)]
            error = np.abs(value - truth).max()
            assert error == pytest.approx(entry["largest_error"][c], abs=1e-12)
            assert error <= 0.5001 * np.ptp(truth) / 65535
            rms = np.sqrt(np.square(truth.astype(float)).mean())
            assert entry["relative_error"][c] == pytest.approx(error / rms, rel=1e-3, abs=1e-12)
            seen.append(name)
    assert seen == NAMES


def both(folder, image):
    return [
        lambda: write_layers(folder, "a", image, NAMES, half=False, metadata=META),
        lambda: write_png16(folder, "a", image, NAMES, metadata=META),
    ]


def test_our_own_files_are_replaced(tmp_path, image):
    for write in both(tmp_path, image):
        write()
    before = {path.name: path.read_bytes() for path in tmp_path.iterdir()}
    for write in both(tmp_path, image**3):
        write()
    assert {path.name for path in tmp_path.iterdir()} == set(before)
    assert all(path.read_bytes() != before[path.name] for path in tmp_path.iterdir())


@pytest.mark.parametrize("k", [0, 1])
@pytest.mark.parametrize("name", ["a_1.exr", "a_1.png"])
def test_a_file_of_the_artists_stays(tmp_path, image, k, name):
    if name.endswith("exr") != (k == 0):
        return
    (tmp_path / name).write_bytes(b"mine")
    with pytest.raises(BakeError, match="is no bake of ours"):
        both(tmp_path, image)[k]()
    assert [path.name for path in tmp_path.iterdir()] == [name]
    assert (tmp_path / name).read_bytes() == b"mine"


@pytest.mark.parametrize("k", [0, 1])
def test_a_folder_in_the_way_is_a_sentence(tmp_path, image, k):
    name = ("a_0.exr", "a_0.png")[k]
    (tmp_path / name).mkdir()
    with pytest.raises(BakeError, match="is a folder"):
        both(tmp_path, image)[k]()
    (tmp_path / "file").write_bytes(b"")
    with pytest.raises(BakeError, match="cannot be written"):
        both(tmp_path / "file", image)[k]()
    assert sorted(path.name for path in tmp_path.iterdir()) == sorted([name, "file"])


FULL = """
import resource, signal, sys
from pathlib import Path
import numpy as np
from prt_baker.addon.prt.errors import BakeError
from prt_baker.addon.prt.files.layers import write_layers, write_png16
signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
resource.setrlimit(resource.RLIMIT_FSIZE, (100_000, 100_000))
image = np.random.default_rng(0).random((256, 256, 8), np.float32)
names, folder = [f"T{k}" for k in range(8)], Path(sys.argv[1])
for write in (
    lambda: write_layers(folder, "a", image, names, half=False, metadata={}),
    lambda: write_png16(folder, "a", image, names, metadata={}),
):
    try:
        write()
    except BakeError as error:
        print(error)
"""


def test_a_disk_that_is_full_is_a_sentence_and_leaves_nothing(tmp_path):
    done = subprocess.run(
        [sys.executable, "-c", FULL, str(tmp_path)], check=True, capture_output=True, text=True
    )
    lines = done.stdout.splitlines()
    assert len(lines) == 2
    reason = "cannot be written (File too large): make room there, or choose another one"
    assert set(lines) == {f"The folder {tmp_path} {reason}"}
    assert not list(tmp_path.iterdir())
