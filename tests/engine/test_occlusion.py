"""A ball beside a black wall: what occlusion of reflections by the baked visibility is worth."""

import importlib.util

import numpy as np
import pytest
from prt_baker.addon.prt import sh
from prt_baker.addon.prt.specular.occlusion import arriving, brightened, occlusion, share
from prt_baker.addon.prt.specular.sheet import zonal_factors
from test_baking import sky


@pytest.fixture(scope="module")
def ball(root):
    """That of benchmarks/occlusion.py, which is no part of the package, with fewer places."""
    path = root / "benchmarks" / "occlusion.py"
    spec = importlib.util.spec_from_file_location("occlusion_benchmark", path)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    module.POINTS = 200
    return module.Ball(256, (32, 64))


@pytest.mark.parametrize("roughness", [0.2, 0.4, 0.6, 0.8, 1.0])
def test_it_halves_the_error_and_beats_ambient_occlusion(ball, roughness):
    skies = [sky(seed, sun=100.0) for seed in range(6)]
    errors = ball.errors(skies, roughness)
    none, ambient, _, _, third, _, fifth = np.mean(errors, axis=0)
    assert third <= 0.5 * none
    assert third < ambient
    assert fifth < 1.05 * third


def test_rough_surfaces_tell_whether_the_sun_stands_behind_the_wall(ball):
    skies = [sky(seed, sun=1000.0) for seed in range(6)]
    _, _, lobe, _, both, _, _ = np.mean(ball.errors(skies, 1.0), axis=0)
    assert both < 0.6 * lobe


def test_under_a_white_sky_it_is_the_share_of_the_lobe(ball):
    """There nothing but the cut at its order is left, and what the look-up makes of the lobe."""
    white = np.ones((32, 64, 3), np.float32)
    for roughness, most in ((0.3, 0.2), (0.7, 0.08), (1.0, 0.03)):
        (errors,) = ball.errors([white], roughness)
        assert errors[4] < most


def test_what_is_open_reflects_all_and_what_is_blocked_nothing():
    directions = np.random.default_rng(0).normal(size=(20, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    everything = np.tile(np.eye(1, 9) * np.sqrt(4 * np.pi), (20, 1))
    for factors in zonal_factors([0.1, 0.5, 1.0]):
        np.testing.assert_allclose(occlusion(everything, directions, factors), 1)
        np.testing.assert_array_equal(occlusion(0 * everything, directions, factors), 0)


def test_a_mirror_sees_along_its_direction_alone():
    """All factors are 1: the visibility itself, cut at its order."""
    seen = np.random.default_rng(1).normal(0, 0.2, (20, 9))
    seen[:, 0] = 2
    directions = np.eye(3)[np.arange(20) % 3]
    found = occlusion(seen, directions, np.ones(5))
    expected = [seen[k] @ _basis(directions[k]) for k in range(20)]
    np.testing.assert_allclose(found, np.clip(expected, 0, 1), atol=1e-6)


def test_open_surfaces_get_all_of_any_light_and_closed_ones_nothing():
    """Under lights that are negative somewhere, too, as truncated ones are."""
    rng = np.random.default_rng(2)
    normals = rng.normal(size=(50, 3))
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    for order in (1, 2, 3, 5):
        light = rng.normal(0, 2, (order**2, 3))
        light[0] = 1
        whole = brightened(light, order)
        transfer = sh.open_transfer(normals, order)[:, None]
        np.testing.assert_allclose(arriving(transfer, normals, whole), 1)
        np.testing.assert_allclose(arriving(0.25 * transfer, normals, whole), 0.25)
        np.testing.assert_array_equal(arriving(0 * transfer, normals, whole), 0)
        np.testing.assert_allclose(arriving(transfer.repeat(3, axis=1), normals, whole), 1)


def test_a_light_that_is_bright_everywhere_stays_as_it_is():
    light = np.concatenate([np.full((1, 3), 3.0), np.full((8, 3), 0.1)])
    np.testing.assert_array_equal(brightened(light, 3), light)
    assert not arriving(np.ones((1, 1, 9)), [[0.0, 0, 1]], 0 * light).any()


def test_sharp_lobes_are_shared_by_what_is_seen_and_cosines_by_the_light():
    lobe, lit = np.array([0.2, 0.9]), np.array([[0.5, 0.6, 0.7], [1, 1, 1]])
    np.testing.assert_allclose(share(lobe, lit, 0.0), lobe[:, None].repeat(3, axis=1))
    np.testing.assert_allclose(share(lobe, lit, [1.0, 1.0]), lit)
    np.testing.assert_allclose(share(lobe, lit, 0.5)[0], 0.2 + 0.25 * np.array([0.3, 0.4, 0.5]))


def _basis(direction):
    """The nine real harmonics as docs/gltf.md writes them."""
    x, y, z = direction
    return np.array(
        [0.28209479, *(0.48860251 * np.array([y, z, x])), 1.09254843 * x * y, 1.09254843 * y * z,
         0.31539157 * (3 * z * z - 1), 1.09254843 * x * z, 0.54627422 * (x * x - y * y)]
    )  # fmt: skip
