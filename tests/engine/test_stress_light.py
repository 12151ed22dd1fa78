"""Pictures of light at the ends of what a file can hold."""

from math import pi, sqrt

import numpy as np
import OpenEXR
import pytest
import shapes
from prt_baker.addon import engine
from prt_baker.addon.prt import sh
from prt_baker.addon.prt.files import images
from prt_baker.addon.prt.job import LightSource
from prt_baker.addon.prt.light import cubemap, lat_long, projection
from stressing import bake, receiver, shown

pytestmark = pytest.mark.filterwarnings("error")

HALF_MAX = 65504.0
SIZES = [(1, 1), (1, 2), (2, 1), (3, 5), (64, 128), (1024, 2048), (4096, 8192)]
SUN = 1e6


def project(pixels, **others):
    return projection.project(LightSource(pixels=np.asarray(pixels, np.float32), **others))


def relative(got, expected):
    """The largest difference over the largest coefficient."""
    return float(np.abs(got - expected).max() / np.abs(expected).max())


def half_exr(path, pixels):
    """``pixels`` (H, W, 3) as half floats, written by OpenEXR."""
    with np.errstate(over="ignore"):
        planes = {c: np.ascontiguousarray(pixels[..., i], np.float16) for i, c in enumerate("RGB")}
    OpenEXR.File({"type": OpenEXR.scanlineimage}, planes).write(str(path))
    return str(path)


@pytest.mark.parametrize("value", [1.0, 1e-30, 1e30])
@pytest.mark.parametrize("size", SIZES)
def test_a_constant_map_is_constant(size, value, record_property):
    """Maps of one colour, 1x1 to 8192x4096, of 1e-30, 1 and 1e30: the first coefficient alone, to
    1e-12."""
    got = projection.project(LightSource(pixels=np.broadcast_to(np.float32(value), (*size, 3))))
    expected = np.zeros((25, 3))
    expected[0] = float(np.float32(value)) * sqrt(4 * pi)
    error = relative(got.image_sh, expected)
    record_property("measured", error)
    assert error < 1e-12


@pytest.mark.parametrize("place", ["pole", "seam", "equator"])
@pytest.mark.parametrize("size", SIZES[3:-1])
def test_a_sun_of_one_texel(size, place, record_property):
    """A sun of 1e6 in one texel at a pole, the seam or the equator, 5x3 to 2048x1024: its energy to
    1e-12, its direction within the texel."""
    height, width = size
    row, column = {"pole": (0, 1), "seam": (height // 3, 0), "equator": (height // 2, 1)}[place]
    pixels = np.zeros((height, width, 3), np.float32)
    pixels[row, column] = SUN
    got = project(pixels).image_sh[:, 0]
    energy = got[0] * sqrt(4 * pi)
    error = abs(energy / (SUN * lat_long.row_solid_angles(height, width)[row]) - 1)
    record_property("measured", error)
    assert error < 1e-12
    middle = got[[3, 1, 2]] / np.linalg.norm(got[[3, 1, 2]])
    texel = lat_long.directions(height, width)[row, column]
    assert np.arccos(min(1, middle @ texel)) <= max(pi / height, 2 * pi / width) / 2


def test_suns_of_one_texel_in_an_8k_map(record_property):
    """Suns of 1e6 in single texels of an 8192x4096 map of grey 0.5: every coefficient is that of
    points of the same energy and of the grey, to 1e-6."""
    height, width = 4096, 8192
    pixels = np.full((height, width, 3), 0.5, np.float32)
    expected = np.zeros(25)
    expected[0] = 0.5 * sqrt(4 * pi)
    areas = lat_long.row_solid_angles(height, width)
    for row, column in ((1000, 0), (2048, 5000), (3000, 8191)):
        pixels[row, column] = SUN
        theta, phi = (row + 0.5) * pi / height, pi - (column + 0.5) * 2 * pi / width
        towards = [np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta)]
        expected += (SUN - 0.5) * areas[row] * sh.basis(towards, 5)
    error = relative(project(pixels).image_sh, expected[:, None])
    record_property("measured", error)
    assert error < 1e-6


def test_a_sun_hides_no_background(record_property):
    """A sun of 1e6 in a map of 1e-3: the sum of the two maps' coefficients, to 1e-13."""
    rng = np.random.default_rng(0)
    dim = rng.random((64, 128, 3), np.float32) * np.float32(1e-3)
    sun = np.zeros_like(dim)
    sun[20, 30] = SUN
    dim[20, 30] = 0
    error = relative(project(dim + sun).image_sh, project(dim).image_sh + project(sun).image_sh)
    record_property("measured", error)
    assert error < 1e-13


def test_half_float_maxima(tmp_path, record_property):
    """A half-float EXR that is 65,504 everywhere, read back: that constant to 1e-12, nothing
    repaired."""
    path = half_exr(tmp_path / "max.exr", np.full((16, 32, 3), HALF_MAX))
    projected = projection.project(LightSource(image=path))
    expected = np.zeros((25, 3))
    expected[0] = HALF_MAX * sqrt(4 * pi)
    error = relative(projected.image_sh, expected)
    record_property("measured", error)
    assert error < 1e-12
    assert not any(projected.repairs.values())


def broken_halves():
    """Half floats with everything that a file may hold, what they are mended to, and the count."""
    pixels = np.random.default_rng(1).random((32, 64, 3)).astype(np.float16)
    pixels[0, 0] = 6e-8, 1.2e-7, 0  # the smallest halves, denormal
    pixels[1, 1] = HALF_MAX
    mended = pixels.copy()
    pixels[2, 2], mended[2, 2] = (np.inf, 1, 2), (HALF_MAX, 1, 2)
    pixels[3, 3], mended[3, 3] = (-np.inf, 1, 2), (0, 1, 2)
    pixels[4, 4], mended[4, 4] = np.nan, 0
    pixels[5, 5:9], mended[5, 5:9] = -1e-7, 0  # denormal and negative
    pixels[6, 6], mended[6, 6] = -0.0, 0
    return pixels, mended, {"negative": 5, "nan": 1, "infinite": 1}


def test_a_half_float_file_with_every_fault(tmp_path, record_property):
    """A half-float EXR with NaN, both infinities, negative values, -0, denormals and maxima: read
    as the mended picture, bit for bit, every repair counted."""
    pixels, mended, repairs = broken_halves()
    projected = projection.project(LightSource(image=half_exr(tmp_path / "faults.exr", pixels)))
    expected = lat_long.project(mended.astype(np.float32), 5)
    record_property("measured", relative(projected.image_sh, expected))
    np.testing.assert_array_equal(projected.image_sh, expected)
    assert projected.repairs == repairs


def test_the_engine_reads_a_faulty_file_in_its_own_process(tmp_path, record_property):
    """The same file through the engine's process: the same bits."""
    pixels, mended, _ = broken_halves()
    source = LightSource(image=half_exr(tmp_path / "faults.exr", pixels))
    with engine.job_folder() as folder:
        got = engine.run_light(source, folder).image_sh
    expected = lat_long.project(mended.astype(np.float32), 5)
    record_property("measured", relative(got, expected))
    np.testing.assert_array_equal(got, expected)


@pytest.mark.parametrize("value", [1e-45, 1e-39, 3.4e38])
def test_float_denormals_and_maxima(tmp_path, value, record_property):
    """A float EXR of denormals (1e-45, 1e-39) and of 3.4e38: read back exactly, projected to the
    constant within 1e-12, without a warning."""
    value = np.float32(value)
    path = str(tmp_path / "extreme.exr")
    images.write_exr(path, np.full((8, 16, 3), value))
    assert (images.read(path) == value).all()
    expected = np.zeros((25, 3))
    expected[0] = float(value) * sqrt(4 * pi)
    error = relative(projection.project(LightSource(image=path)).image_sh, expected)
    record_property("measured", error)
    assert error < 1e-12


@pytest.mark.parametrize("value", [np.nan, -np.inf, np.inf, -1.0, 0.0])
@pytest.mark.parametrize("size", [(1, 1), (3, 5)])
def test_a_map_of_nothing_sound_is_black(size, value, record_property):
    """Maps, 1x1 too, of NaN, infinities, negative values or 0 alone: no light, all zeros."""
    got = project(np.full((*size, 3), value)).image_sh
    record_property("measured", np.abs(got).max())
    assert not got.any()


@pytest.mark.parametrize("size", [1, 2, 7, 256])
def test_cubemaps_of_any_size(size, record_property):
    """Cubemaps with faces of 1 to 256 texels: one colour is constant, and a sun of 1e6 in a corner
    texel has the energy of its solid angle, to 1e-6 (1e-12 from 64 texels on)."""
    ones = project(np.ones((6 * size, size, 3)), may_be_cubemap=True)
    assert ones.is_cubemap
    expected = np.zeros((25, 3))
    expected[0] = sqrt(4 * pi)
    strip = np.zeros((6 * size, size, 3))
    strip[0, 0] = SUN
    energy = project(strip, may_be_cubemap=True).image_sh[0] * sqrt(4 * pi)
    sun = np.abs(energy / (SUN * cubemap.solid_angles(size)[0, 0]) - 1).max()
    error = max(relative(ones.image_sh, expected), sun)
    record_property("measured", error)
    assert error < (1e-6 if size < 64 else 1e-12)


def test_a_cubemap_with_faults(record_property):
    """A cubemap with NaN, infinite and negative texels: that of the mended faces, bit for bit."""
    strip = np.random.default_rng(2).random((6 * 8, 8, 3), np.float32)
    mended = strip.copy()
    strip[0, 0], mended[0, 0] = np.nan, 0
    strip[20, 3], mended[20, 3] = -2, 0
    strip[40, 5, 0], mended[40, 5, 0] = np.inf, np.delete(mended.reshape(-1), 40 * 24 + 15).max()
    got = project(strip, may_be_cubemap=True)
    expected = project(mended, may_be_cubemap=True).image_sh
    record_property("measured", relative(got.image_sh, expected))
    np.testing.assert_array_equal(got.image_sh, expected)
    assert got.repairs == {"negative": 1, "nan": 1, "infinite": 1}


@pytest.mark.parametrize("exponent", [1, 2, 128, 254, 255])
def test_hdr_files_at_the_ends_of_their_exponent(tmp_path, exponent, record_property):
    """.hdr files with exponents 1 to 255 (1e-38 to 1.7e38): each read as mantissa times power of
    two, bit for bit, its projection constant to 1e-12."""
    path = tmp_path / "extreme.hdr"
    header = b"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y 4 +X 4\n"
    path.write_bytes(header + bytes([255, 128, 0, exponent]) * 16)
    expected = np.ldexp([255.0, 128.0, 0.0], exponent - 136)
    np.testing.assert_array_equal(images.read(str(path))[0, 0], expected.astype(np.float32))
    got = projection.project(LightSource(image=str(path))).image_sh
    constant = np.zeros((25, 3))
    constant[0] = expected * sqrt(4 * pi)
    error = relative(got, constant)
    record_property("measured", error)
    assert error < 1e-12


@pytest.mark.parametrize("strength", [0.0, 1e-30, 1e30])
def test_strengths_of_the_world(strength, record_property):
    """Worlds of strength 0, 1e-30 and 1e30, turned: coefficients in proportion, to 1e-12."""
    image_sh = np.random.default_rng(3).normal(size=(25, 3))
    turn, _ = np.linalg.qr(np.random.default_rng(4).normal(size=(3, 3)))
    plain, strong = (projection.world_sh(image_sh, [s] * 3, turn) for s in (1.0, strength))
    error = float(np.abs(strong - strength * plain).max() / max(strength, 1e-300))
    record_property("measured", error)
    assert error < 1e-12


MAPS = {
    "black": np.zeros((4, 8, 3)),
    "1x1": np.ones((1, 1, 3)),
    "sun": np.where(np.arange(64 * 128)[:, None] == 4000, SUN, np.zeros(3)).reshape(64, 128, 3),
    "maximum": np.full((4, 8, 3), 3e38),
    "nan": np.full((4, 8, 3), np.nan),
}


@pytest.mark.parametrize("kind", list(MAPS))
def test_the_light_changes_no_transfer(kind, record_property):
    """Baked under a black, 1x1, one-sun, 3e38 and all-NaN map: the transfer has the bits of a white
    world's, and the light it is shown in is finite."""
    vertices, triangles, normals = shapes.torus_knot(30, 8)
    knot = [receiver(vertices, triangles, normals)]
    source = LightSource(pixels=np.asarray(MAPS[kind], np.float32))
    results = bake(knot, vertices, triangles, source, rays=64)
    white = shown(bake(knot, vertices, triangles, rays=64))
    record_property("measured", np.abs(shown(results) - white).max())
    np.testing.assert_array_equal(shown(results), white)
    assert np.isfinite(shown(results) @ results.image_sh[:9]).all()
