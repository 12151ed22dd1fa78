from math import pi

import numpy as np
import pytest
from prt_baker.addon.prt.light import lat_long, map_sampler
from prt_baker.addon.prt.light.map_sampler import Blocks, MapSampler
from scipy.stats import chi2


def sun_and_sky(height=24, width=40, seed=0):
    pixels = np.random.default_rng(seed).random((height, width, 3), np.float32) ** 4
    pixels[5, 7] = (300, 200, 100)
    return pixels


def texel_of(directions, height, width):
    theta = np.arccos(np.clip(directions[..., 2], -1, 1))
    u = 0.5 - np.arctan2(directions[..., 1], directions[..., 0]) / (2 * pi)
    row = np.minimum((theta / pi * height).astype(int), height - 1)
    return row * width + np.minimum((u * width).astype(int), width - 1)


def test_neighbours_along_the_curve_share_a_side():
    row, column = np.divmod(map_sampler.along_hilbert(16, 16), 16)
    steps = np.abs(np.diff(row)) + np.abs(np.diff(column))
    np.testing.assert_array_equal(steps, 1)


@pytest.mark.parametrize("shape", [(1, 1), (8, 16), (5, 13), (13, 5)])
def test_the_curve_meets_every_cell_once(shape):
    cells = map_sampler.along_hilbert(*shape)
    np.testing.assert_array_equal(np.sort(cells), np.arange(shape[0] * shape[1]))


def test_the_curve_fills_a_map_of_two_squares_without_a_jump():
    row, column = np.divmod(map_sampler.along_hilbert(16, 32), 32)
    assert (np.abs(np.diff(row)) + np.abs(np.diff(column))).max() == 1


@pytest.mark.parametrize("limit", [1 << 21, 60])
def test_blocks_hold_the_light_of_the_map(limit):
    pixels = sun_and_sky(23, 41)
    blocks = Blocks.of(pixels, limit)
    solid_angle = lat_long.row_solid_angles(23, 41)[:, None, None]
    np.testing.assert_allclose(blocks.flux.sum((0, 1)), (pixels * solid_angle).sum((0, 1)))
    np.testing.assert_allclose(blocks.solid_angles().sum(), 4 * pi)
    assert blocks.flux[..., 0].size <= max(limit * 1.5, 1)


@pytest.mark.parametrize("limit", [1 << 21, 60])
def test_places_share_out_the_blocks_light_where_it_is(limit):
    pixels = sun_and_sky(23, 41)
    blocks = Blocks.of(pixels, limit)
    directions, weights = (np.concatenate(parts) for parts in zip(*blocks.places(64), strict=True))
    row, column = blocks.at(directions)
    found = row * blocks.flux.shape[1] + column
    for c in range(4):
        sums = np.bincount(found, weights[:, c], blocks.flux[..., 0].size)
        expected = blocks.flux_and_solid_angle()[..., c].ravel()
        np.testing.assert_allclose(sums, expected, rtol=1e-12, atol=1e-15)
    np.testing.assert_allclose(np.linalg.norm(directions, axis=1), 1)


@pytest.mark.parametrize("limit", [1 << 21, 60])
def test_texels_are_met_as_often_as_their_light_says(monkeypatch, limit):
    """Chi-square, whether a texel is chosen at once or within its block."""
    monkeypatch.setattr(map_sampler, "BLOCKS", limit)
    pixels = sun_and_sky()
    sampler = MapSampler(pixels, floor=0.1)
    random = np.random.default_rng(1)
    count = 400_000
    samples = sampler.sample(random.random(count), random)
    height, width = pixels.shape[:2]
    found = np.bincount(texel_of(samples.directions, height, width), minlength=height * width)
    solid_angle = lat_long.row_solid_angles(height, width)[:, None]
    expected = (sampler.density(pixels) * solid_angle).ravel() * count
    assert expected.sum() == pytest.approx(count, rel=1e-9)
    statistic = ((found - expected) ** 2 / expected).sum()
    assert chi2.sf(statistic, height * width - 1) > 1e-3


def test_directions_inside_a_texel_are_uniform():
    sampler = MapSampler(np.ones((1, 1, 3), np.float32))
    random = np.random.default_rng(2)
    directions = sampler.sample(random.random(200_000), random).directions
    cells = ((directions[:, 2] + 1) * 8).astype(int) * 16 + texel_of(directions, 1, 16)
    found = np.bincount(cells, minlength=256)
    statistic = ((found - found.mean()) ** 2 / found.mean()).sum()
    assert chi2.sf(statistic, 255) > 1e-3


def test_every_sample_says_its_own_pixel_and_density():
    pixels = sun_and_sky()
    samples = MapSampler(pixels).shifted_sets(30, 0)
    found = texel_of(samples.directions, *pixels.shape[:2])
    np.testing.assert_array_equal(samples.pixels, pixels.reshape(-1, 3)[found])
    np.testing.assert_allclose(np.linalg.norm(samples.directions, axis=-1), 1)


def test_a_set_is_stratified():
    """Each of N samples lies in its own N-th of the map's light: a sun that has a third of it gets
    a third of each set, give or take two."""
    pixels = np.ones((64, 128, 3), np.float32)
    solid_angle = lat_long.row_solid_angles(64, 128)[20]
    pixels[20, 30] = 1 + 2 * pi / solid_angle
    samples = MapSampler(pixels).shifted_sets(90, 3)
    at_sun = (samples.pixels[..., 0] > 1).sum(axis=1)
    assert np.abs(at_sun - 30).max() <= 2


def test_the_mean_over_sets_is_the_integral():
    pixels = sun_and_sky(64, 128)
    samples = MapSampler(pixels).shifted_sets(64, 4)
    values = samples.pixels * samples.directions[..., 2:] ** 2 / samples.density[..., None]
    solid_angle = lat_long.row_solid_angles(64, 128)[:, None, None]
    expected = (pixels * lat_long.directions(64, 128)[..., 2:] ** 2 * solid_angle).sum((0, 1))
    of_sets = values.mean(axis=1)
    standard_error = of_sets.std(axis=0) / len(of_sets) ** 0.5
    assert (np.abs(of_sets.mean(axis=0) - expected) < 4 * standard_error).all()
    assert (standard_error < 0.03 * expected).all()


def test_no_light_is_left_out():
    blue = np.zeros((16, 32, 3), np.float32)
    blue[3, 4, 2] = 1e-30
    blue[8, 9] = 1e6
    sampler = MapSampler(blue)
    assert sampler.density(np.zeros(3)) > 0
    samples = sampler.shifted_sets(16, 0)
    assert np.isfinite(samples.density).all()
    assert (samples.density > 0).all()


def test_a_black_map_is_drawn_from_evenly():
    samples = MapSampler(np.zeros((4, 8, 3), np.float32)).shifted_sets(64, 0)
    np.testing.assert_allclose(samples.density, 1 / (4 * pi))
    assert np.abs(samples.directions.mean((0, 1))).max() < 5e-3


def test_the_same_seed_gives_the_same_bits():
    sampler = MapSampler(sun_and_sky())
    np.testing.assert_array_equal(
        sampler.shifted_sets(20, 5).directions, sampler.shifted_sets(20, 5).directions
    )
    assert (sampler.shifted_sets(20, 5).directions != sampler.shifted_sets(20, 6).directions).any()
