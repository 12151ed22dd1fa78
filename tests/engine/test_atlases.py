"""Atlases on disk: what is written reads back, and lies where the node group looks for it."""

import numpy as np
import OpenEXR
import pytest
from prt_baker.addon.prt.errors import BakeError
from prt_baker.addon.prt.files.atlases import read_tiles, write_tiles
from prt_baker.addon.prt.tiles import LARGEST, largest_size, tile_grid


def names(count):
    return [f"T{k}" for k in range(count)]


@pytest.mark.parametrize("count", [1, 4, 7, 12, 28, 78])
def test_what_is_written_reads_back(tmp_path, count):
    image = np.random.default_rng(count).normal(size=(8, 8, count)).astype(np.float32)
    write_tiles(tmp_path / "a.exr", image, names(count), half=False, metadata={"prtBaker": "x"})
    read, found = read_tiles(tmp_path / "a.exr")
    np.testing.assert_array_equal(read, image)
    assert list(found) == names(count)
    write_tiles(tmp_path / "h.exr", 1e6 * image, names(count), half=True, metadata={})
    read, _ = read_tiles(tmp_path / "h.exr")
    expected = np.clip(1e6 * image, -65504, 65504).astype(np.float16)
    np.testing.assert_array_equal(read, expected)


def test_a_tile_lies_where_it_is_said_to(tmp_path):
    """Tile 3 of seven, row 0 at the bottom: right end of the upper row of a grid of 4 x 2."""
    image = np.zeros((8, 8, 28), np.float32)
    image[0, 2, 14] = 5
    write_tiles(tmp_path / "a.exr", image, names(28), half=False, metadata={"prtBaker": "abc"})
    with OpenEXR.File(str(tmp_path / "a.exr")) as file:
        pixels = np.array(file.parts[0].channels["RGBA"].pixels)
        assert file.parts[0].header["prtBaker"] == "abc"
    assert pixels.shape == (16, 32, 4)
    assert np.argwhere(pixels).tolist() == [[7, 3 * 8 + 2, 2]]
    assert b"prtBaker" in (tmp_path / "a.exr").read_bytes()[: 1 << 16]


def test_grids_are_powers_of_two_that_hold_all():
    for count in range(1, 100):
        columns, rows = tile_grid(count)
        assert columns * rows >= count
        assert columns in (rows, 2 * rows)
        assert columns & (columns - 1) == rows & (rows - 1) == 0
        assert largest_size(count) * columns == LARGEST


def test_no_room_is_an_os_error_and_another_picture_a_sentence(tmp_path):
    image = np.zeros((4, 4, 4), np.float32)
    with pytest.raises(OSError, match="cannot be written"):
        write_tiles(tmp_path / "no" / "a.exr", image, names(4), half=False, metadata={})
    (tmp_path / "b.exr").write_bytes(b"sky")
    with pytest.raises(BakeError, match="none of ours"):
        read_tiles(tmp_path / "b.exr")
