"""What the coefficients leave out, under pictures at the ends of what a file can hold."""

from math import pi

import numpy as np
import pytest
import shapes
from prt_baker.addon.prt.job import LightSource
from prt_baker.addon.prt.light import lat_long, projection
from prt_baker.addon.prt.tracing.transfer import relative_rms
from stressing import bake, receiver

pytestmark = pytest.mark.filterwarnings("error")

SUN = 1e6
COVER = 0.5, 0.7  # half its side, its height above the floor


@pytest.fixture(scope="module")
def stage():
    """A floor, and the floor and the cover above it as occluders."""
    floor = shapes.grid([-2, -2, 0], [4, 0, 0], [0, 4, 0], 12)
    half, height = COVER
    cover = shapes.grid([-half, -half, height], [2 * half, 0, 0], [0, 2 * half, 0], 1)
    return receiver(*floor), *shapes.join(floor, cover)


def lit(stage, pixels, strength=1.0, **settings):
    """Residual and exit radiance of white, coefficients and residual together, (E, 3)."""
    floor, *scene = stage
    source = LightSource((strength,) * 3, pixels=np.asarray(pixels, np.float32))
    results = bake([floor], *scene, source, residual=True, **settings)
    result = results.receivers[0]
    residual = result.at_elements(result.residual)[:, 0].astype(np.float64)
    transfer = result.at_elements(result.transfer)[:, 0].astype(np.float64)
    coefficients = projection.world_sh(results.image_sh, source.strength, np.eye(3))
    return residual, transfer @ coefficients[: transfer.shape[1]] + residual


def one_sun(height, width, row, column, background=0.0):
    pixels = np.full((height, width, 3), background, np.float32)
    pixels[row, column] = SUN
    return pixels


@pytest.mark.parametrize("value", [1e-40, 1.0, 65504.0, 1e36])
@pytest.mark.parametrize("size", [(1, 1), (64, 128)])
def test_a_constant_map_leaves_nothing_out(stage, size, value, record_property):
    """Maps of one colour, 1x1 to 128x64, of 1e-40 to 1e36: the residual is the rays' noise, at
    most 3 % of the light."""
    residual, _ = lit(stage, np.full((*size, 3), value))
    error = np.abs(residual).max() / float(np.float32(value))
    record_property("measured", error)
    assert error < 0.03


@pytest.mark.parametrize("value", [0.0, np.nan, -1.0, np.inf])
@pytest.mark.parametrize("size", [(1, 1), (4, 8)])
def test_a_map_without_light_leaves_none(stage, size, value, record_property):
    """Maps, 1x1 too, of 0, NaN, negative values or infinities alone: every residual is 0."""
    residual, _ = lit(stage, np.full((*size, 3), value))
    record_property("measured", np.abs(residual).max())
    assert not residual.any()


def shadowed(places, pixels_shape, row, column):
    """Whether the cover hides all (1), some or none (0) of a texel from points (E, 3)."""
    height, width = pixels_shape
    half, above = COVER
    hidden = []
    for y in np.linspace(row, row + 1, 5):
        for x in np.linspace(column, column + 1, 5):
            theta, phi = y * pi / height, pi - x * 2 * pi / width
            there = places[:, :2] + above * np.tan(theta) * np.array([np.cos(phi), np.sin(phi)])
            hidden.append((np.abs(there) < half).all(axis=1))
    return np.mean(hidden, axis=0)


@pytest.mark.parametrize("size", [(64, 128), (512, 1024), (4096, 8192)])
def test_a_sun_of_one_texel_throws_its_shadow(stage, size, record_property):
    """A sun of 1e6 in one texel of maps of 128x64 to 8192x4096: what sees it has its irradiance,
    what does not has none, to 1 % of it."""
    height, width = size
    row, column = height // 6, width // 5
    _, radiance = lit(stage, one_sun(height, width, row, column))
    places = stage[0].vertices[stage[0].corner_vertices]
    hidden = shadowed(places, size, row, column)
    cosine = np.cos((row + 0.5) * pi / height)
    full = SUN * lat_long.row_solid_angles(height, width)[row] * cosine / pi
    error = max(
        np.abs(radiance[hidden == 0] / full - 1).max(), np.abs(radiance[hidden == 1] / full).max()
    )
    record_property("measured", error)
    assert (hidden == 1).sum() > 10
    assert error < 0.01


def test_a_sun_below_the_horizon_lights_nothing(stage, record_property):
    """The same sun under the floor: coefficients and residual add up to 0, to 1e-5 of what the
    coefficients alone show."""
    residual, radiance = lit(stage, one_sun(64, 128, 56, 30))
    error = np.abs(radiance).max() / np.abs(residual).max()
    record_property("measured", error)
    assert error < 1e-5


@pytest.mark.parametrize("strength", [0.0, 1e-30, 2.0**-20, 1e30])
def test_residuals_are_in_proportion_to_the_strength(stage, strength, record_property):
    """A sun under strengths of 0 to 1e30: the residual in proportion, to 1e-5."""
    pixels = np.zeros((32, 64, 3)) + 0.2
    pixels[5, 20] = 100
    plain, strong = (lit(stage, pixels, s)[0] for s in (1.0, strength))
    error = relative_rms(strong / max(strength, 1e-300), plain * (strength > 0))
    record_property("measured", error)
    assert error < 1e-5


def test_bad_texels_leave_what_the_mended_map_leaves(stage, record_property):
    """A map with NaN, infinite and negative texels: the residuals of the mended map, bit for
    bit."""
    pixels = np.random.default_rng(0).random((16, 32, 3)).astype(np.float32)
    pixels[3, 4] = 50
    mended = pixels.copy()
    pixels[1, 1], mended[1, 1] = np.nan, 0
    pixels[2, 9], mended[2, 9] = np.inf, 50
    pixels[5, 5], mended[5, 5] = -3, 0
    first, second = lit(stage, pixels)[0], lit(stage, mended)[0]
    record_property("measured", np.abs(first - second).max())
    np.testing.assert_array_equal(first, second)
