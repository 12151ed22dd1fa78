import struct

import numpy as np
import OpenEXR
import pytest
from prt_baker.addon.prt.errors import BakeError
from prt_baker.addon.prt.files import images, rgbe

RNG_SHAPE = (24, 48, 3)
COMPRESSIONS = ["NO", "RLE", "ZIPS", "ZIP", "PIZ"]


@pytest.fixture
def pixels():
    return np.random.default_rng(0).random(RNG_SHAPE, np.float32)


def save(path, channels, **header):
    OpenEXR.File({"type": OpenEXR.scanlineimage, **header}, channels).write(str(path))
    return str(path)


def planes(pixels, prefix="", dtype=np.float32):
    return {
        prefix + name: np.ascontiguousarray(pixels[..., i], dtype) for i, name in enumerate("RGB")
    }


def refused(path):
    """The sentence; BakeError that names the file and is one sentence."""
    with pytest.raises(BakeError) as caught:
        images.read(str(path))
    sentence = str(caught.value)
    assert str(path) in sentence
    assert "\n" not in sentence
    assert not sentence.endswith(".")
    return sentence


# OpenEXR


def test_what_was_written_reads_back_equal(tmp_path, pixels):
    pixels[0, 0] = -1, np.inf, 1e30
    path = str(tmp_path / "light – ünïcode.exr")
    images.write_exr(path, pixels, {"comment": "a sun"})
    back = images.read(path)
    np.testing.assert_array_equal(back, pixels)
    assert back.dtype == np.float32
    assert OpenEXR.File(path).header()["comment"] == "a sun"


def test_the_top_row_is_first(tmp_path):
    pixels = np.zeros(RNG_SHAPE, np.float32)
    pixels[0] = 1
    path = save(tmp_path / "top.exr", {"RGB": pixels})
    np.testing.assert_array_equal(images.read(path), pixels)


@pytest.mark.parametrize("compression", COMPRESSIONS)
@pytest.mark.parametrize("kind", ["scanlineimage", "tiledimage"])
def test_lossless_compressions_read_equal(tmp_path, pixels, compression, kind):
    header = {"compression": getattr(OpenEXR, f"{compression}_COMPRESSION")}
    header["type"] = getattr(OpenEXR, kind)
    if kind == "tiledimage":
        header["tiles"] = OpenEXR.TileDescription()
    path = save(tmp_path / "any.exr", {"RGB": pixels}, **header)
    np.testing.assert_array_equal(images.read(path), pixels)


@pytest.mark.parametrize("dtype", [np.float16, np.float32, np.uint32])
def test_half_float_and_integer_channels_are_read(tmp_path, pixels, dtype):
    values = (pixels * 1000).astype(dtype)
    path = save(tmp_path / "type.exr", planes(values, dtype=dtype))
    np.testing.assert_array_equal(images.read(path), values.astype(np.float32))


def test_colours_of_different_types_are_read(tmp_path, pixels):
    colours = planes(pixels)
    colours["G"] = colours["G"].astype(np.float16)
    expected = pixels.copy()
    expected[..., 1] = colours["G"]
    path = save(tmp_path / "mixed.exr", colours)
    np.testing.assert_array_equal(images.read(path), expected)


def test_alpha_and_depth_are_left_out(tmp_path, pixels):
    more = {"A": np.zeros(RNG_SHAPE[:2], np.float32), "Z": np.ones(RNG_SHAPE[:2], np.float32)}
    path = save(tmp_path / "more.exr", planes(pixels) | more)
    np.testing.assert_array_equal(images.read(path), pixels)


def test_a_grey_picture_is_grey_light(tmp_path, pixels):
    path = save(tmp_path / "grey.exr", {"Y": pixels[..., 0].copy()})
    np.testing.assert_array_equal(images.read(path), np.repeat(pixels[..., :1], 3, axis=-1))


def test_a_data_window_is_the_picture_as_in_blender(tmp_path, pixels):
    height, width, _ = RNG_SHAPE
    corners = np.array([-7, 5], np.int32), np.array([width - 8, height + 4], np.int32)
    display = np.array([0, 0], np.int32), np.array([99, 49], np.int32)
    path = save(tmp_path / "w.exr", {"RGB": pixels}, dataWindow=corners, displayWindow=display)
    np.testing.assert_array_equal(images.read(path), pixels)


@pytest.mark.parametrize(
    ("layers", "chosen"),
    [
        (["diffuse."], "diffuse."),
        (["a.", ""], ""),
        (["ViewLayer.AO.", "ViewLayer.Combined.", "ViewLayer.Env."], "ViewLayer.Combined."),
    ],
)
def test_the_layer_that_is_read(tmp_path, pixels, layers, chosen):
    channels = {"Y": pixels[..., 0].copy()}
    for place, layer in enumerate(layers):
        channels |= planes(pixels + place, layer)
    path = save(tmp_path / "layers.exr", channels)
    np.testing.assert_array_equal(images.read(path), pixels + layers.index(chosen))


def test_the_first_part_with_colours_is_read(tmp_path, pixels):
    parts = [
        OpenEXR.Part({}, {"Z": pixels[..., 0].copy()}, "depth"),
        OpenEXR.Part({}, {"Y": pixels[..., 0].copy()}, "grey"),
        OpenEXR.Part({}, {"RGB": pixels}, "colour"),
        OpenEXR.Part({}, {"RGB": pixels + 1}, "other"),
    ]
    OpenEXR.File(parts).write(str(tmp_path / "parts.exr"))
    np.testing.assert_array_equal(images.read(str(tmp_path / "parts.exr")), pixels)


def test_a_picture_without_colours_is_refused(tmp_path, pixels):
    path = save(tmp_path / "depth.exr", {"Z": pixels[..., 0].copy()})
    assert "no channels" in refused(path)


def patched(tmp_path, pixels, attribute, values):
    """A file whose header's box ``attribute`` was overwritten."""
    path = tmp_path / f"{attribute}.exr"
    data = bytearray(open(save(path, {"RGB": pixels}), "rb").read())  # noqa: PTH123, SIM115
    place = data.index(attribute.encode() + b"\0box2i\0") + len(attribute) + 7 + 4
    data[place : place + 16] = struct.pack("<4i", *values)
    path.write_bytes(data)
    return path


@pytest.mark.parametrize(
    "box",
    [
        (0, 0, -1, -1),
        (0, 0, 1 << 20, 1 << 20),
        (0, 0, 2**31 - 1, 2**31 - 1),
        (-(2**31), -(2**31), 2**31 - 1, 2**31 - 1),
        (10, 10, 0, 0),
        (0, 0, 47, 10_000),
    ],
)
def test_bogus_sizes_are_refused(tmp_path, pixels, box):
    refused(patched(tmp_path, pixels, "dataWindow", box))


@pytest.mark.parametrize("compression", COMPRESSIONS)
def test_a_cut_off_exr_is_refused(tmp_path, pixels, compression):
    path = tmp_path / "cut.exr"
    save(path, {"RGB": pixels}, compression=getattr(OpenEXR, f"{compression}_COMPRESSION"))
    whole = path.read_bytes()
    for size in np.linspace(4, len(whole) - 1, 12).astype(int):
        path.write_bytes(whole[:size])
        refused(path)


def damaged(whole, rng, kind):
    """A copy that is cut off, or with some bytes of its head or of all of it changed."""
    if kind == 0:
        return whole[: rng.integers(len(whole))]
    data = bytearray(whole)
    last = min(len(data), 500) if kind == 1 else len(data)
    for place in rng.integers(0, last, 1 + 10 * kind):
        data[place] = rng.integers(256)
    return bytes(data)


@pytest.mark.parametrize("suffix", ["exr", "multi.exr", "hdr"])
def test_damaged_files_are_pictures_or_sentences(tmp_path, pixels, suffix):
    path = tmp_path / f"damaged.{suffix}"
    if suffix == "hdr":
        path.write_bytes(hdr(packed_rows(rgbe_pixels())))
    elif suffix == "multi.exr":
        OpenEXR.File([OpenEXR.Part({}, {"RGB": pixels}, name) for name in "ab"]).write(str(path))
    else:
        save(path, planes(pixels, dtype=np.float16), compression=OpenEXR.PIZ_COMPRESSION)
    whole, rng, sentences = path.read_bytes(), np.random.default_rng(7), 0
    for copy in range(200):
        path.write_bytes(damaged(whole, rng, copy % 3))
        try:
            assert images.read(str(path)).shape[2:] == (3,)
        except BakeError:
            sentences += 1
    assert sentences > 66  # every one that is cut off, and more


# What is no picture


def test_a_missing_file_is_refused(tmp_path):
    assert "No such file" in refused(tmp_path / "none.exr")


def test_a_folder_is_refused(tmp_path):
    (tmp_path / "folder.exr").mkdir()
    refused(tmp_path / "folder.exr")


@pytest.mark.parametrize(
    ("content", "reason"),
    [(b"", "is empty"), (b"\x89PNG\r\n\x1a\n" + bytes(99), "neither"), (b"v", "neither")],
)
def test_other_content_is_refused(tmp_path, content, reason):
    (tmp_path / "picture.exr").write_bytes(content)
    assert reason in refused(tmp_path / "picture.exr")


def test_a_magic_number_alone_is_refused(tmp_path):
    (tmp_path / "magic.exr").write_bytes(images.EXR_MAGIC)
    refused(tmp_path / "magic.exr")


def test_a_name_that_no_file_can_have_is_refused():
    refused("null\0byte.exr")


def test_a_picture_that_cannot_be_written_is_one_sentence(tmp_path, pixels):
    with pytest.raises(BakeError, match="cannot be written"):
        images.write_exr(str(tmp_path / "none" / "out.exr"), pixels)


# Radiance HDR


def rgbe_pixels(height=6, width=40):
    """Mantissas and exponents (H, W, 4) with runs and with noise, none like an old repeat."""
    values = np.random.default_rng(5).integers(2, 256, (height, width, 4)).astype(np.uint8)
    values[..., 3] = np.random.default_rng(6).integers(120, 140, (height, width))
    values[:, 10:30] = values[:, 10:11]
    values[0, 0] = 0
    return values


def decoded(values):
    floats = values.astype(np.float64)
    scale = np.where(values[..., 3:] == 0, 0, 2.0 ** (floats[..., 3:] - 136))
    return (floats[..., :3] * scale).astype(np.float32)


def hdr(rows, height=6, width=40, lines=b"FORMAT=32-bit_rle_rgbe\n", resolution=b"-Y %d +X %d"):
    return b"#?RADIANCE\n" + lines + b"\n" + resolution % (height, width) + b"\n" + rows


def packed_plane(values):
    """Runs of 3 or more as runs, the rest as literals."""
    out, place = bytearray(), 0
    while place < len(values):
        run = 1
        while place + run < len(values) and run < 127 and values[place + run] == values[place]:
            run += 1
        out += bytes([128 + run, values[place]]) if run > 2 else bytes([1, values[place]])
        place += run if run > 2 else 1
    return bytes(out)


def packed_rows(values):
    start = b"\x02\x02" + struct.pack(">H", values.shape[1])
    return b"".join(start + b"".join(packed_plane(row[:, k]) for k in range(4)) for row in values)


def old_rows(values):
    """Repeats of whole pixels, two digits of them where there are 256 or more."""
    out = bytearray()
    for row in values:
        place = 0
        while place < len(row):
            out += bytes(row[place])
            repeats = 0
            while place + 1 + repeats < len(row) and (row[place + 1 + repeats] == row[place]).all():
                repeats += 1
            if repeats:
                out += bytes([1, 1, 1, repeats & 255])
            if repeats > 255:
                out += bytes([1, 1, 1, repeats >> 8])
            place += 1 + repeats
    return bytes(out)


@pytest.mark.parametrize("encode", [packed_rows, old_rows, lambda values: values.tobytes()])
def test_every_encoding_of_an_hdr_reads_equal(tmp_path, encode):
    values = rgbe_pixels()
    path = tmp_path / "light.hdr"
    path.write_bytes(hdr(encode(values)))
    np.testing.assert_array_equal(images.read(str(path)), decoded(values))


def test_encodings_may_change_from_row_to_row():
    values = rgbe_pixels()
    rows = packed_rows(values[:2]) + values[2:4].tobytes() + old_rows(values[4:])
    np.testing.assert_array_equal(rgbe.decode(hdr(rows), 10_000), decoded(values))


def test_an_old_repeat_may_take_two_digits():
    values = np.full((2, 700, 4), 130, np.uint8)
    back = rgbe.decode(hdr(old_rows(values), 2, 700), 10_000)
    np.testing.assert_array_equal(back, decoded(values))


@pytest.mark.parametrize("width", [1, 7, 8, 127, 128, 129, 300])
def test_any_width_is_read(width):
    values = rgbe_pixels(3, max(width, 31))[:, :width].copy()
    rows = packed_rows(values) if width >= 8 else values.tobytes()
    np.testing.assert_array_equal(rgbe.decode(hdr(rows, 3, width), 10_000), decoded(values))


def test_mantissas_have_no_half_step_and_no_exposure_as_in_blender():
    data = hdr(bytes([200, 1, 0, 130]), 1, 1, b"FORMAT=32-bit_rle_rgbe\nEXPOSURE=2.0\n")
    np.testing.assert_array_equal(rgbe.decode(data, 1), [[[3.125, 0.015625, 0]]])


@pytest.mark.parametrize(
    ("data", "reason"),
    [
        (hdr(b"", lines=b"FORMAT=32-bit_rle_xyze\n"), "XYZ"),
        (hdr(b"", 0, 40), "claims"),
        (hdr(b"", 999_999_999, 999_999_999), "claims"),
        (hdr(b"", resolution=b"+X %d -Y %d"), "top row"),
        (hdr(b"", resolution=b"-Y -%d +X %d"), "top row"),
        (hdr(b""), "cut off"),
        (hdr(b"\x02\x02\x00\x28" + b"\xff\x01" * 50), "damaged"),
        (hdr(b"\x02\x02\x00\x28" + b"\x00" * 50), "cut off"),
        (hdr(b"\x05\x05\x05\x80\x01\x01\x01\x64"), "damaged"),
        (hdr(b"\x01\x01\x01\x03" + b"\x05" * 999, 1, 40), "damaged"),
        (b"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n", "cut off"),
        (b"#?", "cut off"),
    ],
)
def test_bad_hdr_files_are_refused(tmp_path, data, reason):
    path = tmp_path / "bad.hdr"
    path.write_bytes(data)
    assert reason in refused(path)


@pytest.mark.parametrize("encode", [packed_rows, old_rows, lambda values: values.tobytes()])
def test_a_cut_off_hdr_is_refused(tmp_path, encode):
    path, whole = tmp_path / "cut.hdr", hdr(encode(rgbe_pixels()))
    for size in range(2, len(whole), 7):
        path.write_bytes(whole[:size])
        refused(path)
