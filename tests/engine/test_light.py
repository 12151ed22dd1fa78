import numpy as np
import pytest
from prt_baker.addon.prt import sh
from prt_baker.addon.prt.errors import BakeError
from prt_baker.addon.prt.files import images
from prt_baker.addon.prt.job import LightSource
from prt_baker.addon.prt.light import cubemap, lat_long, projection
from scipy.spatial.transform import Rotation

SOUND = {"negative": 0, "nan": 0, "infinite": 0}


@pytest.fixture
def pixels():
    return np.random.default_rng(0).random((32, 64, 3), np.float32)


def radiance(directions):
    x, y, z = np.moveaxis(directions, -1, 0)
    return np.stack([np.exp(x - 0.5 * y), 1 + x * y * z, np.exp(z * y)], axis=-1)


def test_no_picture_is_the_constant_one():
    projected = projection.project(LightSource(strength=(3, 2, 1)))
    values = sh.evaluate(projected.image_sh, np.eye(3))
    np.testing.assert_allclose(values, 1, atol=1e-14)
    assert projected.image_sh.shape == (25, 3)
    assert sum(projected.repairs.values()) == projected.width == projected.height == 0


def test_a_colour_is_the_same_light_as_a_picture_of_it():
    colour = projection.project(LightSource()).image_sh
    white = projection.project(LightSource(pixels=np.ones((8, 16, 3), np.float32))).image_sh
    np.testing.assert_allclose(colour, white, atol=1e-12)


def test_a_picture_is_read_and_projected_without_strength_and_rotation(tmp_path, pixels):
    path = str(tmp_path / "light.exr")
    images.write_exr(path, pixels)
    turn = ((0.0, -1.0, 0.0), (1.0, 0.0, 0.0), (0.0, 0.0, 1.0))
    projected = projection.project(LightSource(strength=(9, 9, 9), image=path, rotation=turn))
    np.testing.assert_array_equal(projected.image_sh, lat_long.project(pixels, 5))
    assert (projected.width, projected.height) == (64, 32)
    assert projected.repairs == SOUND


def test_a_file_that_cannot_be_read_is_one_sentence(tmp_path):
    with pytest.raises(BakeError, match=r"none\.hdr"):
        projection.project(LightSource(image=str(tmp_path / "none.hdr")))


def test_a_picture_without_pixels_is_one_sentence():
    with pytest.raises(BakeError, match="no pixels"):
        projection.project(LightSource(pixels=np.empty((0, 0, 3), np.float32)))


def test_a_picture_in_the_shape_of_a_cross_is_a_cubemap():
    size = 64
    cross = np.full((3 * size, 4 * size, 3), 1e6, np.float32)  # the corners must not be read
    places = [(1, 2), (1, 0), (0, 1), (2, 1), (1, 1), (1, 3)]
    for face, (row, column) in enumerate(places):
        part = cross[row * size : (row + 1) * size, column * size : (column + 1) * size]
        part[:] = radiance(cubemap.directions(face, size))
    sphere = radiance(lat_long.directions(128, 256)).astype(np.float32)
    np.testing.assert_allclose(
        projection.project(LightSource(pixels=cross, may_be_cubemap=True)).image_sh,
        projection.project(LightSource(pixels=sphere)).image_sh,
        atol=2e-3,
    )


@pytest.mark.parametrize("shape", [(32, 64), (20, 20), (1, 1), (10, 33)])
def test_a_picture_of_any_other_shape_is_lat_long(shape):
    values = np.random.default_rng(1).random((*shape, 3), np.float32)
    expected = lat_long.project(values, 5)
    np.testing.assert_array_equal(projection.project(LightSource(pixels=values)).image_sh, expected)


def test_the_worlds_light_is_strength_times_the_image_at_the_rotated_direction():
    image_sh = np.random.default_rng(2).normal(size=(25, 3))
    rotation = Rotation.random(random_state=3).as_matrix()
    directions = np.eye(3)
    world = sh.evaluate(projection.world_sh(image_sh, (3, 2, 1), rotation), directions)
    image = sh.evaluate(image_sh, directions @ rotation.T)
    np.testing.assert_allclose(world, image * [3, 2, 1], atol=1e-13)


def test_turning_the_coefficients_is_projecting_the_turned_picture():
    angle = np.radians(90)
    c, s = np.cos(angle), np.sin(angle)
    rotation = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])
    pixels = np.random.default_rng(4).random((32, 64, 3), np.float32)
    turned = np.roll(pixels, 16, axis=1)  # its value at w is the old one at R w, a quarter on
    np.testing.assert_allclose(
        projection.world_sh(lat_long.project(pixels, 5), (1, 1, 1), rotation),
        lat_long.project(turned, 5),
        atol=1e-12,
    )


def test_bad_pixels_are_mended_and_counted(pixels):
    broken, mended = pixels.copy(), pixels.copy()
    broken[0, 0] = -1, -np.inf, 0.5
    mended[0, 0] = 0, 0, 0.5
    broken[1, 1:4] = np.nan
    mended[1, 1:4] = 0
    broken[2, 2, 1] = np.inf
    broken[3, 3, 0] = 7
    mended[3, 3, 0] = mended[2, 2, 1] = 7
    broken[4, 4] = np.nan, -2, np.inf
    mended[4, 4] = 0, 0, 7
    before = broken.copy()
    repaired, repairs = projection.repair(broken)
    np.testing.assert_array_equal(repaired, mended)
    assert repairs == {"negative": 2, "nan": 4, "infinite": 2}
    np.testing.assert_array_equal(broken, before)
    projected = projection.project(LightSource(pixels=broken))
    np.testing.assert_array_equal(projected.image_sh, lat_long.project(mended, 5))
    assert projected.repairs == repairs


def test_a_sound_picture_is_not_copied(pixels):
    repaired, repairs = projection.repair(pixels)
    assert repaired is pixels
    assert repairs == SOUND


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf, -1.0])
def test_a_picture_of_nothing_sound_is_black(value):
    pixels = np.full((4, 8, 3), value, np.float32)
    projected = projection.project(LightSource(pixels=pixels))
    assert not projected.image_sh.any()
    assert sum(projected.repairs.values()) == 32


def test_a_black_picture_is_no_light():
    assert not projection.project(
        LightSource(pixels=np.zeros((4, 8, 3), np.float32))
    ).image_sh.any()


def test_huge_radiance_does_not_overflow():
    projected = projection.project(LightSource(pixels=np.full((64, 128, 3), 3e38, np.float32)))
    expected = float(np.float32(3e38)) * np.sqrt(4 * np.pi)
    np.testing.assert_allclose(projected.image_sh[0], expected, rtol=1e-13)


def test_blenders_worlds_are_lat_long_whatever_their_shape():
    cross = np.random.default_rng(3).random((48, 64, 3), np.float32)
    projected = projection.project(LightSource(pixels=cross))
    np.testing.assert_array_equal(projected.image_sh, lat_long.project(cross, 5))
    assert not projected.is_cubemap


def test_a_folder_of_six_faces_is_a_cubemap(tmp_path):
    faces = np.random.default_rng(4).random((6, 16, 16, 3), np.float32)
    for name, face in zip(projection.FACE_NAMES, faces, strict=True):
        images.write_exr(str(tmp_path / f"{name}.exr"), face)
    source = LightSource(image=str(tmp_path), may_be_cubemap=True)
    projected = projection.project(source)
    np.testing.assert_array_equal(projected.image_sh, cubemap.project(faces, 5))
    assert projected.is_cubemap
    (tmp_path / "ny.exr").unlink()
    with pytest.raises(BakeError, match="ny"):
        projection.project(source)


def test_the_picture_is_handed_on_repaired_as_a_lat_long_map(pixels):
    assert projection.project(LightSource()).pixels is None
    np.testing.assert_array_equal(projection.project(LightSource(pixels=pixels)).pixels, pixels)
    pixels[3, 4, 1] = np.nan
    assert np.isfinite(projection.project(LightSource(pixels=pixels)).pixels).all()
    strip = np.random.default_rng(5).random((16, 96, 3), np.float32)
    projected = projection.project(LightSource(pixels=strip, may_be_cubemap=True))
    found = lat_long.project(projected.pixels, 5)
    np.testing.assert_allclose(found, projected.image_sh, atol=2e-2)
