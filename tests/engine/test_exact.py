from math import pi

import numpy as np
import pytest
from prt_baker.addon.prt import sh
from prt_baker.addon.prt.files import images
from prt_baker.addon.prt.light import lat_long, projection
from prt_baker.addon.prt.light.exact import CELLS, ExactLight, cells
from real_light import OnTheKnot, exit_radiance, rays_about, small, studio_lights
from scipy.spatial.transform import Rotation

RAYS = 64
MAP_RAYS = 66


def unit(count, seed=0):
    vectors = np.random.default_rng(seed).normal(size=(count, 3))
    return (vectors / np.linalg.norm(vectors, axis=1, keepdims=True)).astype(np.float32)


def sky_with_sun(height=64, width=128, sun=1e4):
    x, y, z = np.moveaxis(lat_long.directions(height, width), -1, 0)
    pixels = np.stack([1 + 0.5 * x, 1.2 + 0.3 * y * z, np.exp(z)], axis=-1)
    pixels[height // 3, width // 5] = (sun, 0.8 * sun, 0.5 * sun)
    return pixels.astype(np.float32)


def everything(point, directions):
    return np.ones(len(directions), np.float32)


def irradiance(pixels, normals, seen=None):
    """By a sum over the texels' centres."""
    height, width = pixels.shape[:2]
    directions = lat_long.directions(height, width).reshape(-1, 3)
    flux = (pixels * lat_long.row_solid_angles(height, width)[:, None, None]).reshape(-1, 3)
    clear = np.ones(len(directions)) if seen is None else seen(directions)
    return np.array([(np.maximum(0, directions @ n) * clear) @ flux for n in normals])


def test_cells_are_equal_patches_that_hold_their_directions():
    found = cells(*unit(2_000_000).T)
    assert found.min() >= 0
    assert found.max() < 2 * CELLS * CELLS
    counts = np.bincount(found, minlength=2 * CELLS * CELLS)
    inside = counts[counts > 0]
    assert np.median(inside) == pytest.approx(2_000_000 / (2 * CELLS**2 * pi / 4), rel=0.05)


def test_a_point_under_the_open_sky_gets_the_whole_irradiance():
    exact = ExactLight(sky_with_sun(), np.eye(3), (1, 1, 1), MAP_RAYS, 0)
    normals = unit(100)
    found = exit_radiance(exact, normals, everything)
    np.testing.assert_array_equal(found, exact.open_exit_radiance(normals))


def test_a_point_that_sees_nothing_gets_none():
    exact = ExactLight(sky_with_sun(), np.eye(3), (1, 1, 1), MAP_RAYS, 0)
    found = exit_radiance(exact, unit(20), lambda _, d: np.zeros(len(d), np.float32))
    np.testing.assert_array_equal(found, 0)


def test_the_open_irradiance_is_the_sum_over_all_texels():
    pixels = sky_with_sun(128, 256)
    sun = lat_long.directions(128, 256)[128 // 3, 256 // 5]
    grazing = np.cross(unit(100), sun)
    grazing /= np.linalg.norm(grazing, axis=1, keepdims=True)
    normals = np.concatenate([unit(200), grazing, grazing + 0.01 * sun, grazing - 0.01 * sun])
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    exact = ExactLight(pixels, np.eye(3), (1, 1, 1), MAP_RAYS, 0)
    fine = pixels.repeat(4, axis=0).repeat(4, axis=1)  # the horizon cuts through the sun's texel
    expected = irradiance(fine, normals) / pi
    error = exact.open_exit_radiance(normals) - expected
    assert np.abs(error).max() < 2e-3 * np.sqrt(np.mean(expected**2))


def test_strength_and_rotation_are_those_of_the_world():
    pixels, normals = sky_with_sun(), unit(50)
    rotation = Rotation.random(random_state=1).as_matrix()
    strength = np.array([2, 0.5, 0])
    turned = ExactLight(pixels, rotation, strength, MAP_RAYS, 0).open_exit_radiance(normals)
    image_sh = projection.world_sh(lat_long.project(pixels, 5), strength, rotation)
    smooth = (sh.open_transfer(normals, 5) @ image_sh)[:, :2]
    assert np.abs(turned[:, :2] - smooth).max() < 0.04 * smooth.max()
    np.testing.assert_array_equal(turned[:, 2], 0)
    plain = ExactLight(pixels, np.eye(3), strength, MAP_RAYS, 0)
    same = plain.open_exit_radiance(normals @ rotation.T)
    np.testing.assert_allclose(turned, same, rtol=1e-5, atol=1e-6)


def test_half_of_a_constant_sky_is_half_of_its_light():
    """A wall along the normal hides half of what a point sees: white is 1/2, whatever the rays."""
    exact = ExactLight(np.ones((1, 1, 3), np.float32), np.eye(3), (1, 1, 1), 258, 0)
    normals = np.tile([[0, 0, 1]], (200, 1)).astype(np.float32)
    found = exit_radiance(exact, normals, lambda _, d: (d[:, 0] > 0).astype(np.float32), count=256)
    np.testing.assert_allclose(found, 0.5, atol=0.02)
    assert found.mean() == pytest.approx(0.5, abs=1e-3)


@pytest.mark.parametrize("sun", [1.0, 100.0, 1e6])
def test_the_shadowed_light_agrees_with_the_texels(sun):
    """Beside a wall that hides the sun or doesn't, on the mean over many points."""
    pixels = sky_with_sun(sun=sun)
    fine = pixels.repeat(8, axis=0).repeat(8, axis=1)  # the wall cuts through texels
    exact = ExactLight(pixels, np.eye(3), (1, 1, 1), 258, 0)
    towards = lat_long.directions(64, 128)[64 // 3, 128 // 5]
    normal = towards + np.array([0.3, 0.5, -0.2])
    normals = np.tile(normal / np.linalg.norm(normal), (1000, 1)).astype(np.float32)
    open_light = exact.open_exit_radiance(normals[:1])
    for wall in ([0.6, -0.64, 0.48], [-0.6, 0.64, -0.48]):

        def seen(d, wall=wall):
            return (d @ wall > 0.1).astype(np.float32)

        found = exit_radiance(exact, normals, lambda _, d, f=seen: f(d), count=256)
        expected = irradiance(fine, normals[:1].astype(np.float64), seen) / pi
        error = found.mean(axis=0, dtype=np.float64) - expected[0]
        assert np.abs(error).max() < 2e-3 * open_light.max()
        assert (found.std(axis=0) < 0.02 * open_light).all()


def test_a_turned_light_is_a_new_one():
    pixels, normals = sky_with_sun(), unit(40)
    rotation = Rotation.random(random_state=4).as_matrix()

    def half(_, d):
        return (d[:, 2] > 0.2).astype(np.float32)

    first = ExactLight(pixels, np.eye(3), (1, 1, 1), MAP_RAYS, 0)
    before = exit_radiance(first, normals, half)
    turned = exit_radiance(first.turned(rotation), normals, half)
    fresh = exit_radiance(ExactLight(pixels, rotation, (1, 1, 1), MAP_RAYS, 0), normals, half)
    np.testing.assert_array_equal(turned, fresh)
    np.testing.assert_array_equal(exit_radiance(first, normals, half), before)


def test_the_bits_do_not_depend_on_the_batches():
    exact = ExactLight(sky_with_sun(), np.eye(3), (1, 1, 1), MAP_RAYS, 0)
    normals = unit(700)
    cosines, directions = rays_about(normals, 0, RAYS)
    picks = np.arange(700) * 31
    drawn = exact.drawn(normals, picks)
    random = np.random.default_rng(5)
    seen, map_seen = random.random((700, RAYS)) < 0.5, random.random(len(drawn.point)) < 0.5
    whole = exact.exit_radiance(normals, cosines, directions, seen, drawn, map_seen)
    for start, stop in ((0, 1), (1, 6), (6, 333), (333, 700)):
        part, those = slice(start, stop), slice(*np.searchsorted(drawn.point, [start, stop]))
        again = exact.drawn(normals[part], picks[part])
        np.testing.assert_array_equal(again.point + start, drawn.point[those])
        np.testing.assert_array_equal(again.directions, drawn.directions[those])
        its = normals[part], cosines, directions[part], seen[part]
        found = exact.exit_radiance(*its, again, map_seen[those])
        np.testing.assert_array_equal(found, whole[part])


@pytest.mark.parametrize(
    "pixels",
    [
        np.zeros((8, 16, 3), np.float32),
        np.zeros((1, 1, 3), np.float32),
        np.full((1, 1, 3), 3e38, np.float32),
        np.full((2, 3, 3), 1e-38, np.float32),
    ],
)
@pytest.mark.parametrize("strength", [(1, 1, 1), (0, 0, 0)])
def test_worlds_at_the_ends_of_float32(pixels, strength):
    exact = ExactLight(pixels, np.eye(3), strength, MAP_RAYS, 0)
    found = exit_radiance(exact, unit(30), lambda _, d: d[:, 2] > 0)
    assert np.isfinite(found).all()
    assert (found >= 0).all()
    assert (found.max() > 0) == (pixels.max() > 0 and max(strength) > 0)


def test_only_directions_above_the_horizon_that_may_be_blocked_are_traced():
    exact = ExactLight(sky_with_sun(), np.eye(3), (1, 1, 1), 100, 0)
    normals = unit(500)
    drawn = exact.drawn(normals, np.arange(500))
    cosines = np.einsum("rc,rc->r", drawn.directions, normals[drawn.point])
    assert (cosines > -1e-6).all()
    np.testing.assert_allclose(drawn.cosines.reshape(-1)[drawn.places], cosines, atol=1e-6)
    assert np.count_nonzero(drawn.cosines) == len(drawn.point)
    assert (np.diff(drawn.point) >= 0).all()
    assert 45 < len(drawn.point) / 500 < 55
    low = exact.drawn(normals, np.arange(500), open_above=0.25)
    np.testing.assert_array_equal(
        low.places, drawn.places[drawn.cosines[drawn.cosines > 0] <= 0.25]
    )
    assert np.count_nonzero(low.is_open) == len(drawn.point) - len(low.point) > 0
    spread = low.spread(np.zeros(len(low.point)))
    np.testing.assert_array_equal(spread, drawn.cosines > 0.25)


@pytest.mark.skipif(not studio_lights(), reason="needs the pictures of the bpy wheel")
def test_the_light_of_real_pictures_on_the_knot():
    """129 traced rays of the map and 256 of the transfer, against all texels of the pictures: a
    relative error of 1 % in the mean and 1.6 % at worst."""
    pictures = [small(file) for file in studio_lights()]
    knot = OnTheKnot(400, pictures)
    errors, traced = zip(*(knot.error(i, 258) for i in range(len(pictures))), strict=True)
    assert np.mean(traced) < 130
    assert np.mean(errors) < 0.01
    assert np.max(errors) < 0.016


@pytest.mark.parametrize("file", studio_lights(), ids=lambda file: file.stem)
def test_the_open_light_of_real_pictures_is_that_of_all_their_texels(file):
    """Surfaces that the brightest texel grazes among them."""
    pixels = projection.repair(images.read(str(file)))[0]
    place = np.unravel_index(pixels.sum(axis=2).argmax(), pixels.shape[:2])
    sun = lat_long.directions(*pixels.shape[:2])[place]
    normals = np.concatenate([unit(20), np.cross(unit(20), sun)])
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    exact = ExactLight(pixels, np.eye(3), (1, 1, 1), MAP_RAYS, 0)
    expected = irradiance(pixels, normals) / pi
    error = exact.open_exit_radiance(normals) - expected
    assert np.abs(error).max() < 2e-3 * np.sqrt(np.mean(expected**2))
