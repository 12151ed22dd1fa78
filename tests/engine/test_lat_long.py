import numpy as np
import pytest
from prt_baker.addon.prt import sh
from prt_baker.addon.prt.light import lat_long

SIZES = [(1, 1), (1, 2), (2, 4), (3, 5), (37, 90), (64, 128), (256, 512)]


def picture(radiance, height, width):
    """A grey map of a function of direction."""
    value = radiance(lat_long.directions(height, width))
    return np.repeat(value[..., None], 3, axis=-1).astype(np.float32)


def supersampled(pixels, order, factor):
    """The same projection by the midpoint rule, from ``factor``² points in each texel."""
    fine = pixels.repeat(factor, axis=0).repeat(factor, axis=1).astype(np.float64)
    height, width = fine.shape[:2]
    weight = lat_long.row_solid_angles(height, width)[:, None, None]
    values = sh.basis(lat_long.directions(height, width), order)
    return np.einsum("yxi,yxc->ic", values * weight, fine)


@pytest.mark.parametrize(("height", "width"), SIZES)
def test_texels_cover_the_sphere(height, width):
    total = lat_long.row_solid_angles(height, width).sum() * width
    assert total == pytest.approx(4 * np.pi, rel=1e-14)


def test_a_row_is_the_difference_of_its_cosines():
    edges = np.cos(np.pi * np.arange(65) / 64)
    expected = 2 * np.pi / 128 * (edges[:-1] - edges[1:])
    np.testing.assert_allclose(lat_long.row_solid_angles(64, 128), expected, rtol=1e-12)


def test_directions_are_blenders():
    u, v = np.meshgrid((np.arange(8) + 0.5) / 8, 1 - (np.arange(4) + 0.5) / 4)
    x, y, z = np.moveaxis(lat_long.directions(4, 8), -1, 0)
    np.testing.assert_allclose(u, 0.5 - np.arctan2(y, x) / (2 * np.pi), atol=1e-15)
    np.testing.assert_allclose(v, 0.5 + np.arcsin(z) / np.pi, atol=1e-15)


@pytest.mark.parametrize(
    ("row", "column", "axis"),
    [(0, 0, (0, 0, 1)), (-1, 0, (0, 0, -1)), (500, 1000, (1, 0, 0)), (500, 500, (0, 1, 0))],
)
def test_places_on_the_picture_look_where_they_should(row, column, axis):
    np.testing.assert_allclose(lat_long.directions(1000, 2000)[row, column], axis, atol=4e-3)


@pytest.mark.parametrize(("height", "width"), SIZES)
def test_a_constant_map_is_a_constant(height, width):
    coefficients = lat_long.project(np.full((height, width, 3), 2, np.float32), 8)
    np.testing.assert_allclose(coefficients[0], 2 * np.sqrt(4 * np.pi), rtol=1e-13)
    assert np.abs(coefficients[1:]).max() < 1e-12


def test_energy_is_exact():
    pixels = np.random.default_rng(0).random((50, 77, 3), np.float32)
    weight = lat_long.row_solid_angles(50, 77)[:, None, None]
    energy = (pixels.astype(np.float64) * weight).sum(axis=(0, 1))
    mean = lat_long.project(pixels, 1)[0] * np.sqrt(4 * np.pi)
    np.testing.assert_allclose(mean, energy, rtol=1e-13)


@pytest.mark.parametrize(("height", "width", "factor"), [(1, 3, 400), (6, 5, 80), (20, 13, 30)])
def test_texels_are_integrated_as_constant_patches(height, width, factor):
    pixels = np.random.default_rng(1).random((height, width, 3), np.float32)
    expected = supersampled(pixels, 5, factor)
    error = np.abs(lat_long.project(pixels, 5) - expected).max()
    coarser = np.abs(supersampled(pixels, 5, factor // 2) - expected).max()
    # what is left is the midpoint rule's own: 1 / (4 - 1) of its last step
    assert error < 0.4 * coarser
    assert error < 2e-4


def test_every_basis_function_projects_to_its_own_coefficient():
    size, order = 128, 5
    for i in range(order**2):
        pixels = picture(lambda w, i=i: sh.basis(w, order)[..., i], size, 2 * size)
        expected = np.zeros((order**2, 3))
        expected[i] = 1
        np.testing.assert_allclose(lat_long.project(pixels, order), expected, atol=2e-3)


def test_a_finer_map_is_closer_by_the_square():
    coefficients = np.random.default_rng(3).normal(size=25)
    errors = []
    for size in (32, 64, 128):
        pixels = picture(lambda w: sh.evaluate(coefficients, w), size, 2 * size)
        errors.append(np.abs(lat_long.project(pixels, 5)[:, 0] - coefficients).max())
    assert errors[0] / errors[1] == pytest.approx(4, rel=0.1)
    assert errors[1] / errors[2] == pytest.approx(4, rel=0.1)


def test_a_map_shifted_by_a_column_is_light_turned_about_z():
    pixels = np.random.default_rng(4).random((16, 24, 3), np.float32)
    angle = -2 * np.pi / 24  # columns run against the azimuth
    c, s = np.cos(angle), np.sin(angle)
    turned = sh.rotate(lat_long.project(pixels, 6), [[c, -s, 0], [s, c, 0], [0, 0, 1]])
    shifted = lat_long.project(np.roll(pixels, 1, axis=1), 6)
    np.testing.assert_allclose(shifted, turned, atol=1e-12)


def test_a_lower_order_is_the_head_of_a_higher_one():
    pixels = np.random.default_rng(5).random((33, 64, 3), np.float32)
    np.testing.assert_allclose(
        lat_long.project(pixels, 3), lat_long.project(pixels, 8)[:9], atol=1e-13
    )


def test_a_read_only_strided_map_is_read_as_it_is():
    pixels = np.random.default_rng(6).random((70, 64, 4), np.float32)
    pixels.setflags(write=False)
    expected = lat_long.project(np.ascontiguousarray(pixels[::-1, :, :3]), 5)
    np.testing.assert_array_equal(lat_long.project(pixels[::-1, :, :3], 5), expected)
