"""Exact light of the smallest, darkest and brightest pictures, on surfaces that see all of it."""

from math import pi

import numpy as np
import pytest
from prt_baker.addon.prt.light import lat_long
from prt_baker.addon.prt.light.exact import ExactLight
from prt_baker.addon.prt.tracing.transfer import relative_rms
from stressing import turned

pytestmark = pytest.mark.filterwarnings("error")

NORMALS = np.random.default_rng(0).normal(size=(40, 3))
NORMALS /= np.linalg.norm(NORMALS, axis=1, keepdims=True)
FINE = 256, 512


def exact(pixels, rotation=None, strength=1.0):
    """Exit radiance (40, 3) of open white surfaces about NORMALS."""
    rotation = np.eye(3) if rotation is None else rotation
    light = ExactLight(np.asarray(pixels, np.float32), rotation, (strength,) * 3, 64, 0)
    return light.open_exit_radiance(NORMALS).astype(np.float64)


def summed(pixels, rotation=None):
    """The same, summed in float64 over every texel of the picture cut into finer ones."""
    rows, columns = FINE[0] // pixels.shape[0], FINE[1] // pixels.shape[1]
    fine = np.repeat(np.repeat(np.asarray(pixels, np.float64), rows, 0), columns, 1).reshape(-1, 3)
    areas = np.repeat(lat_long.row_solid_angles(*FINE), FINE[1])
    towards = lat_long.directions(*FINE).reshape(-1, 3)
    normals = NORMALS if rotation is None else NORMALS @ rotation.T
    return np.maximum(normals @ towards.T, 0) @ (areas[:, None] * fine) / pi


SIZES = [(1, 1), (1, 2), (4, 8), (64, 128)]


@pytest.mark.parametrize("size", SIZES)
def test_open_surfaces_under_the_smallest_maps(size, record_property):
    """Random maps of 1x1 to 128x64, turned: what open surfaces leave agrees with a sum over
    the map in float64 to 2e-3 (RMS)."""
    pixels = np.random.default_rng(1).random((*size, 3)).astype(np.float32)
    error = relative_rms(exact(pixels, turned()), summed(pixels, turned()))
    record_property("measured", error)
    assert error < 2e-3


@pytest.mark.parametrize("size", SIZES[1::2])
def test_open_surfaces_under_a_sun_of_one_texel(size, record_property):
    """A sun of 1e6 in one texel of maps of 2x1 and 128x64: the same, to 2e-3."""
    pixels = np.zeros((*size, 3), np.float32)
    pixels[size[0] // 3, size[1] // 2] = 1e6
    error = relative_rms(exact(pixels), summed(pixels))
    record_property("measured", error)
    assert error < 2e-3


@pytest.mark.parametrize("value", [0.0, 1e-40, 65504.0, 1e37])
def test_open_surfaces_under_one_colour(value, record_property):
    """Maps of one colour of 0 to 1e37: open white surfaces have that colour, to 1e-3."""
    value = float(np.float32(value))
    light = exact(np.full((8, 16, 3), value))
    error = np.abs(light - value).max() / max(value, 1e-45)
    record_property("measured", error)
    assert error < 1e-3


def test_open_surfaces_under_any_strength(record_property):
    """Strengths of 0, 1e-30 and 1e30: in proportion, to 1e-6."""
    pixels = np.random.default_rng(2).random((16, 32, 3)).astype(np.float32)
    plain = exact(pixels)
    for strength in (0.0, 1e-30, 1e30):
        light = exact(pixels, strength=strength)
        error = float(np.abs(light - strength * plain).max() / max(strength, 1e-300))
        record_property("measured", error)
        assert error < 1e-6
