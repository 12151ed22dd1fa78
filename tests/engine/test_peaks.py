from math import cos, degrees, pi, radians

import numpy as np
import pytest
from prt_baker.addon.prt import sh
from prt_baker.addon.prt.light import lat_long, peaks
from prt_baker.addon.prt.light.projection import world_sh
from scipy.spatial.transform import Rotation

HEIGHT, WIDTH = 128, 256
SUN = np.array([0.36, 0.48, 0.8])
LAMP = np.array([-0.8, 0.0, -0.6])


def unit(count, seed=0):
    vectors = np.random.default_rng(seed).normal(size=(count, 3))
    return (vectors / np.linalg.norm(vectors, axis=1, keepdims=True)).astype(np.float32)


def disc(towards, radius, height=HEIGHT, width=WIDTH):
    return lat_long.directions(height, width) @ towards > cos(radians(radius))


def sky(height=HEIGHT, width=WIDTH):
    x, _, z = np.moveaxis(lat_long.directions(height, width), -1, 0)
    return np.stack([1 + 0.3 * x, np.ones_like(x), 1.3 + 0.4 * z], axis=-1).astype(np.float32)


def lit():
    """A sky with a sun of 6 degrees and a dimmer, warm lamp of 10."""
    pixels = sky()
    pixels[disc(SUN, 6)] += (500, 480, 450)
    pixels[disc(LAMP, 10)] += (60, 40, 20)
    return pixels


def flux(pixels):
    height, width = pixels.shape[:2]
    solid_angles = lat_long.row_solid_angles(height, width)[:, None, None]
    return (pixels * solid_angles).sum(axis=(0, 1))


def angle(a, b):
    return degrees(np.arccos(np.clip(np.dot(a, b), -1, 1)))


@pytest.fixture(scope="module")
def cut():
    return peaks.find(lit(), np.eye(3), (1, 1, 1), 2)


def test_the_suns_of_a_sky_are_found_the_one_that_matters_first(cut):
    first, second = cut.peaks
    assert angle(first.direction, SUN) < 0.5
    assert angle(second.direction, LAMP) < 0.5
    assert degrees(first.angular_radius) == pytest.approx(6, abs=0.4)
    assert degrees(second.angular_radius) == pytest.approx(10, abs=0.4)


def test_a_peak_gives_the_irradiance_of_what_rises_above_the_sky(cut):
    """Of a surface that faces it: a disc's light times the mean cosine, (1 + cos a) / 2."""
    for peak, towards, radius, colour in (
        (cut.peaks[0], SUN, 6, (500, 480, 450)),
        (cut.peaks[1], LAMP, 10, (60, 40, 20)),
    ):
        light = flux(disc(towards, radius)[..., None] * np.array(colour))
        expected = light * (1 + cos(radians(radius))) / 2
        np.testing.assert_allclose(peak.irradiance, expected, rtol=0.02)


def test_what_is_left_and_what_was_taken_are_the_whole_light(cut):
    whole = lat_long.project(lit(), 5)
    np.testing.assert_allclose(cut.cut_sh + cut.peak_sh.sum(axis=0), whole, atol=1e-12)
    for light, coefficients in zip(cut.removed, cut.peak_sh, strict=True):
        np.testing.assert_allclose(coefficients, lat_long.project(light, 5), atol=1e-12)
    assert (cut.removed >= 0).all()
    assert (cut.removed.sum(axis=0) <= lit() * (1 + 1e-6)).all()


def test_discs_in_place_of_the_peaks_keep_the_energy(cut):
    """To 1e-3 of the light, in every channel: band 0 of a disc with the irradiance E facing it is
    2 E / (1 + cos a) times 0.282."""
    for peak, coefficients in zip(cut.peaks, cut.peak_sh, strict=True):
        disc_flux = 2 * np.array(peak.irradiance) / (1 + cos(peak.angular_radius))
        np.testing.assert_allclose(disc_flux * sh.basis(SUN, 1)[0], coefficients[0], rtol=1e-6)


def test_the_world_turns_and_tints_its_peaks():
    rotation = Rotation.random(random_state=2).as_matrix()
    strength = np.array([0.5, 1, 2])
    cut = peaks.find(lit(), rotation, strength, 1)
    plain = peaks.find(lit() * strength.astype(np.float32), np.eye(3), (1, 1, 1), 1)
    np.testing.assert_allclose(
        rotation @ cut.peaks[0].direction, plain.peaks[0].direction, atol=2e-3
    )
    np.testing.assert_allclose(cut.peaks[0].irradiance, plain.peaks[0].irradiance, rtol=1e-3)
    whole = world_sh(lat_long.project(lit(), 5), strength, rotation)
    np.testing.assert_allclose(cut.cut_sh + cut.peak_sh.sum(axis=0), whole, atol=1e-10)


@pytest.mark.parametrize("pixels", [sky(), np.zeros((16, 32, 3), np.float32), np.ones((1, 1, 3))])
def test_nothing_is_cut_out_of_a_sky_without_peaks(pixels):
    cut = peaks.find(np.asarray(pixels, np.float32), np.eye(3), (1, 1, 1), 4)
    assert cut.peaks == ()
    assert cut.peak_sh.shape == (0, 25, 3)
    np.testing.assert_allclose(cut.cut_sh, lat_long.project(np.asarray(pixels), 5), atol=1e-12)
    normals, picks = unit(3), np.arange(3)
    drawn = cut.rays().drawn(normals, picks)
    assert len(drawn.point) == len(drawn.directions) == 0
    assert cut.rays().shadowed_cosine(normals, drawn, np.empty(0)).shape == (3, 0)


def test_no_more_are_found_than_asked_for():
    assert len(peaks.find(lit(), np.eye(3), (1, 1, 1), 1).peaks) == 1
    assert peaks.find(lit(), np.eye(3), (1, 1, 1), 0).peaks == ()


def test_a_sun_of_one_texel_and_one_at_a_pole():
    pixels = sky()
    pixels[30, 40] = 1e6
    found = peaks.find(pixels, np.eye(3), (1, 1, 1), 1)
    towards = lat_long.directions(HEIGHT, WIDTH)[30, 40]
    assert angle(found.peaks[0].direction, towards) < 1e-3
    assert degrees(found.peaks[0].angular_radius) < 1.5
    pixels = sky()
    pixels[disc(np.array([0, 0, 1]), 6)] += 500
    assert angle(peaks.find(pixels, np.eye(3), (1, 1, 1), 1).peaks[0].direction, (0, 0, 1)) < 0.5


def test_large_maps_are_searched_at_a_lower_resolution(monkeypatch):
    monkeypatch.setattr(peaks, "TEXELS", HEIGHT * WIDTH // 16)
    cut = peaks.find(lit(), np.eye(3), (1, 1, 1), 1)
    assert cut.removed.shape == (1, HEIGHT // 4, WIDTH // 4, 3)
    assert angle(cut.peaks[0].direction, SUN) < 0.5
    np.testing.assert_allclose(
        cut.cut_sh + cut.peak_sh.sum(axis=0), lat_long.project(lit(), 5), atol=1e-12
    )


def test_the_cosine_of_an_open_surface_is_that_of_the_light_taken_out(cut):
    """With every ray clear; a surface that faces the peak gets 1, one beyond its horizon 0."""
    towards = np.array([peak.direction for peak in cut.peaks], np.float32)
    normals = np.concatenate([towards, -towards, unit(200)])
    rays = cut.rays()
    picks = np.arange(len(normals))
    drawn = rays.drawn(normals, picks)
    found = rays.shadowed_cosine(normals, drawn, np.ones(len(drawn.point)))
    directions = lat_long.directions(4 * HEIGHT, 4 * WIDTH).reshape(-1, 3)
    solid_angles = np.repeat(lat_long.row_solid_angles(4 * HEIGHT, 4 * WIDTH), 4 * WIDTH)
    for k, light in enumerate(cut.removed):
        fine = (light @ peaks.LUMINANCE).repeat(4, axis=0).repeat(4, axis=1).reshape(-1)
        weight = fine * solid_angles
        clamped = np.array([(np.maximum(0, directions @ n)) @ weight for n in normals])
        facing = (directions @ towards[k]) @ weight
        np.testing.assert_allclose(found[:, k], clamped / facing, atol=2e-3)
        assert found[k, k] == pytest.approx(1, abs=1e-3)
        assert found[len(towards) + k, k] == 0


def test_a_wall_through_the_sun_hides_half_of_it(cut):
    rays = cut.rays(32, 1)
    side = np.cross(SUN, [0, 0, 1])
    normals = np.tile(SUN, (500, 1)).astype(np.float32)
    picks = np.arange(500) * 7
    drawn = rays.drawn(normals, picks)
    found = rays.shadowed_cosine(normals, drawn, drawn.directions @ side > 0)[:, 0]
    assert found.mean() == pytest.approx(0.5, abs=0.01)
    assert found.std() < 0.06


def test_the_bits_do_not_depend_on_the_batches(cut):
    rays, normals, picks = cut.rays(), unit(300), np.arange(300) * 13
    drawn = rays.drawn(normals, picks)
    clear = drawn.directions[:, 0] > 0.1
    whole = rays.shadowed_cosine(normals, drawn, clear)
    for part in (slice(0, 1), slice(1, 120), slice(120, 300)):
        its = rays.drawn(normals[part], picks[part])
        those = slice(*np.searchsorted(drawn.point, [part.start, part.stop]))
        np.testing.assert_array_equal(its.directions, drawn.directions[those])
        found = rays.shadowed_cosine(normals[part], its, clear[those])
        np.testing.assert_array_equal(found, whole[part])


def test_cutting_out_the_peaks_leaves_the_light_of_wedges_to_the_coefficients():
    """Beside walls, what order 3 misses falls to a tenth with sun and lamp cut out."""
    pixels = lit()
    cut = peaks.find(pixels, np.eye(3), (1, 1, 1), 2)
    directions = lat_long.directions(HEIGHT, WIDTH).reshape(-1, 3)
    solid_angles = np.repeat(lat_long.row_solid_angles(HEIGHT, WIDTH), WIDTH)
    normals, walls = unit(100, 3), unit(100, 4)
    seen = np.maximum(0, normals @ directions.T) * (walls @ directions.T > 0) / pi * solid_angles
    transfer = seen @ sh.basis(directions, 3)
    exact = seen @ pixels.reshape(-1, 3)
    plain = transfer @ lat_long.project(pixels, 5)[:9]
    back = seen @ cut.removed.sum(axis=0).reshape(-1, 3)
    with_peaks = transfer @ cut.cut_sh[:9] + back
    errors = [np.sqrt(np.mean((found - exact) ** 2)) for found in (plain, with_peaks)]
    assert errors[1] < 0.1 * errors[0]
