"""Prefiltered radiance against brute force, and what lies where in the image of reflections."""

import numpy as np
import pytest
from prt_baker.addon.prt.light import lat_long
from prt_baker.addon.prt.specular import brdf, prefilter, sheet, table

SUN = np.array([0.6, 0.5, 0.3]) / np.linalg.norm([0.6, 0.5, 0.3])


@pytest.fixture(scope="module")
def picture():
    """A sky with clouds and a sun of one texel, 10,000 times as bright."""
    towards = lat_long.directions(256, 512)
    sky = 1 + 0.5 * np.sin(5 * towards[..., :1] + [0, 1, 2]) * np.cos(7 * towards[..., 1:2])
    pixels = (sky * (1.2 + towards[..., 2:])).astype(np.float32)
    pixels[np.unravel_index(np.argmax(towards @ SUN), (256, 512))] = 1e4, 9e3, 7e3
    return pixels


@pytest.fixture(scope="module")
def made(picture):
    return sheet.make(picture)


def by_brute_force(pixels, directions, roughness):
    """The mean of every texel under the lobe."""
    towards = lat_long.directions(*pixels.shape[:2]).reshape(-1, 3)
    solid = np.repeat(lat_long.row_solid_angles(*pixels.shape[:2]), pixels.shape[1])
    weights = brdf.lobe(roughness, directions @ towards.T) * solid
    return weights @ pixels.reshape(-1, 3).astype(float) / weights.sum(axis=1)[:, None]


def looks(roughness, count=40):
    """Directions all around, at the wrap, at the poles and about the sun."""
    random = np.random.default_rng(3)
    found = random.normal(size=(count, 3))
    found[:6] = SUN + roughness**2 * found[:6] / 2
    found[6:12] = [-1, 0, 0] + 0.02 * found[6:12]
    found[12:18] = [0, 0, 1] + 0.02 * found[12:18]
    found[18:24] = [0, 0, -1] + 0.02 * found[18:24]
    return found / np.linalg.norm(found, axis=1, keepdims=True)


@pytest.mark.parametrize("level", range(6, 15))
def test_levels_are_brute_force(picture, made, level):
    roughness = sheet.ROUGHNESSES[level]
    assert roughness >= 0.25 - 1e-9
    directions = looks(roughness)
    read = sheet.radiance(*made, directions, roughness)
    assert read == pytest.approx(by_brute_force(picture, directions, roughness), rel=1e-2)


def test_between_levels_it_is_near(picture, made):
    """Away from the sun, where a line in the logarithm is the truth."""
    directions = looks(0.3)[6:]
    for roughness in (0.27, 0.33, 0.65, 0.93):
        exact = by_brute_force(picture, directions, roughness)
        assert sheet.radiance(*made, directions, roughness) == pytest.approx(exact, rel=4e-2)


def test_a_constant_world_stays_constant():
    for pixels in (None, np.ones((90, 180, 3), np.float32), np.ones((1100, 2200, 3), np.float32)):
        kept = sheet.make(pixels, cell=(144, 72))
        for roughness in (0, 0.05, 0.1, 0.3, 0.77, 1):
            read = sheet.radiance(*kept, looks(0.2), roughness)
            assert read == pytest.approx(np.ones_like(read), abs=1e-4)


def test_no_line_at_the_wrap_the_poles_or_between_levels(made):
    """Reads on both sides of each, 1e-5 apart."""
    angles = np.linspace(-1.5, 1.5, 60)
    z, s = np.sin(angles), np.cos(angles)
    sides = [np.stack([-s, side * 1e-5 * s, z], axis=1) for side in (-1, 1)]
    turns = np.linspace(0, 2 * np.pi, 30)
    near, over = (
        np.stack([d * np.cos(turns), d * np.sin(turns), np.ones(30)], axis=1) for d in (1e-5, -1e-5)
    )
    for roughness in (0, 0.05, 0.088, 0.2, 1):
        for first, second in (sides, (near, over)):
            reads = [sheet.radiance(*made, d, roughness) for d in (first, second)]
            assert reads[0] == pytest.approx(reads[1], rel=2e-3)
    directions = looks(0.3)
    for border in (*sheet.ROUGHNESSES[:-1], sheet.SHARPEST):
        low, high = (sheet.radiance(*made, directions, border * f) for f in (1 - 1e-6, 1 + 1e-6))
        assert low == pytest.approx(high, rel=1e-3)


def test_a_mirror_shows_the_picture(picture, made):
    towards = lat_long.directions(256, 512)[8:-8:7, ::7].reshape(-1, 3)
    dark = np.arccos(np.clip(towards @ SUN, -1, 1)) > 0.1
    texels = picture[8:-8:7, ::7].reshape(-1, 3)[dark]
    assert sheet.radiance(*made, towards[dark], 0) == pytest.approx(texels, rel=3e-2)


def test_a_large_picture_is_kept_finer_and_very_bright_ones_fit_into_half_floats():
    pixels = np.full((1024, 2048, 3), 0.5, np.float32)
    pixels[300, 700] = 3e6
    its_sheet, image = sheet.make(pixels, cell=(80, 40))
    assert (its_sheet.detail, image.shape) == (4, (8 * 40 + sheet.TILE, 320, 4))
    assert image.max() <= sheet.LARGEST_HALF
    away = np.array([[0, 0, -1.0]])
    assert sheet.radiance(its_sheet, image, away, 0.0) == pytest.approx(0.5, rel=1e-5)


def test_the_strip_holds_the_table(made):
    roughness, n_v = np.random.default_rng(0).random((2, 2000))
    read = sheet.split_sum(made[1], roughness, n_v)
    assert read == pytest.approx(table.bilinear(table.load(), roughness, n_v), abs=1e-6)


def test_zonal_factors_have_closed_forms_at_both_ends():
    assert sheet.zonal_factors(1.0)[0] == pytest.approx([1, 2 / 3, 1 / 4, 0, -1 / 24], abs=1e-6)
    assert sheet.zonal_factors(0.0)[0] == pytest.approx(np.ones(5), abs=1e-4)
    width = sheet.zonal_factors(np.linspace(0, 1, 20))[:, 1]
    assert (np.diff(width) < 0).all()


def test_resampling_keeps_the_light():
    pixels = np.random.default_rng(0).random((30, 50, 3)).astype(np.float32)
    light = lat_long.row_solid_angles(30, 50) @ pixels.sum(axis=1)
    for height, width in ((11, 17), (64, 128), (30, 50)):
        other = prefilter.resampled(pixels, height, width)
        kept = lat_long.row_solid_angles(height, width) @ other.sum(axis=1)
        assert kept == pytest.approx(light, rel=1e-5)


def test_threads_change_nothing(picture):
    first, second = (sheet.make(picture[::4, ::4], threads, (80, 40))[1] for threads in (1, 2))
    assert np.array_equal(first, second)
