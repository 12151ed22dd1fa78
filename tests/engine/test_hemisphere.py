"""The local set of directions and its turn to each point's normal."""

import numpy as np
import pytest
from prt_baker.addon.prt import sh
from prt_baker.addon.prt.tracing import hemisphere

UP = np.array([0.0, 0.0, 1.0])


def random_frames(count, seed=0):
    rng = np.random.default_rng(seed)
    normals = rng.normal(size=(count, 3))
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    normals[:2] = UP, -UP
    return normals, hemisphere.frames(normals, rng.random(count) * 7)


def test_frames_are_rotations_that_end_in_the_normal():
    normals, frames = random_frames(100)
    matrices = frames.matrices().astype(float)
    np.testing.assert_allclose(matrices[:, :, 2], normals, atol=1e-6)
    np.testing.assert_allclose(matrices @ matrices.transpose(0, 2, 1), [np.eye(3)] * 100, atol=1e-6)
    np.testing.assert_allclose(np.linalg.det(matrices), 1, atol=1e-6)


@pytest.mark.parametrize("order", [1, 2, 3, 5, 8])
def test_turn_is_the_rotation_of_the_basis(order):
    _, frames = random_frames(20)
    local = np.random.default_rng(1).normal(size=(20, order**2)).astype(np.float32)
    turned = hemisphere.Turn(order)(frames, local)
    expected = [
        sh.rotation_matrix(matrix, order) @ values
        for matrix, values in zip(frames.matrices(), local, strict=True)
    ]
    np.testing.assert_allclose(turned, expected, atol=2e-6)


def test_rays_are_the_set_in_each_frame_from_each_origin():
    _, frames = random_frames(10)
    local = hemisphere.hemisphere_set(64, 3).directions
    out = np.empty((640, 3), np.float32)
    in_world = hemisphere.RaysInWorld(local)
    in_world.directions(frames.matrices(), out)
    expected = np.einsum("pca,ja->pjc", frames.matrices(), local).reshape(-1, 3)
    np.testing.assert_allclose(out, expected, atol=1e-6)
    planes = np.empty((10, 3, 64), np.float32)
    in_world.planes(frames.matrices(), planes)
    np.testing.assert_allclose(np.moveaxis(planes, 1, 2).reshape(-1, 3), expected, atol=1e-6)
    origins = np.random.default_rng(2).normal(size=(10, 3)).astype(np.float32)
    in_world.origins(origins, out)
    np.testing.assert_array_equal(out, np.repeat(origins, 64, axis=0))


@pytest.mark.parametrize("order", [2, 3, 5])
@pytest.mark.parametrize("count", [1, 16, 256])
def test_an_open_sky_gives_the_exact_transfer_at_any_count(order, count):
    weights = hemisphere.hemisphere_set(count, order).weights
    np.testing.assert_allclose(weights.sum(axis=0), sh.open_transfer(UP, order), atol=1e-6)


def test_directions_are_cosine_distributed():
    z = hemisphere.cosine_fibonacci(10000)[:, 2]
    for power in (1, 2, 3):
        np.testing.assert_allclose((z**power).mean(), 2 / (power + 2), atol=1e-4)
