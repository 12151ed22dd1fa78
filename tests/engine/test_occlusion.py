"""A ball beside a black wall: what occlusion of reflections by the baked visibility is worth."""

import importlib.util

import numpy as np
import pytest
from prt_baker.addon.prt.specular.occlusion import occlusion
from prt_baker.addon.prt.specular.sheet import zonal_factors
from test_baking import sky


@pytest.fixture(scope="module")
def scene(root):
    """benchmarks/occlusion.py, which is no part of the package, with fewer places and rays."""
    path = root / "benchmarks" / "occlusion.py"
    spec = importlib.util.spec_from_file_location("occlusion_benchmark", path)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    module.POINTS, module.LOBE = 300, 400
    return module


@pytest.fixture(scope="module")
def ball(scene):
    return scene.Ball(rays=256)


@pytest.mark.parametrize("roughness", [0.2, 0.4, 0.6])
def test_it_halves_the_error_and_beats_ambient_occlusion(ball, roughness):
    lobes = ball.lobes(roughness)
    errors = [list(ball.errors(sky(seed, sun=100.0), lobes, roughness)) for seed in range(6)]
    none, ambient, _, third, _, fifth = np.mean(errors, axis=0)
    assert third <= 0.5 * none
    assert third < ambient
    assert fifth < third


def test_under_a_white_sky_it_is_the_share_of_the_lobe(ball):
    """There nothing but the cut at its order is left."""
    white = np.ones((8, 16, 3), np.float32)
    for roughness, most in ((0.3, 0.16), (0.7, 0.03), (1.0, 0.02)):
        errors = list(ball.errors(white, ball.lobes(roughness), roughness))
        assert errors[3] < most


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


def _basis(direction):
    """The nine real harmonics as docs/gltf.md writes them."""
    x, y, z = direction
    return np.array(
        [0.28209479, *(0.48860251 * np.array([y, z, x])), 1.09254843 * x * y, 1.09254843 * y * z,
         0.31539157 * (3 * z * z - 1), 1.09254843 * x * z, 0.54627422 * (x * x - y * y)]
    )  # fmt: skip
