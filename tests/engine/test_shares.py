"""What the rays that are looked at stand for."""

import numpy as np
import pytest
from prt_baker.addon.prt.bounces.chunks import Chunk
from prt_baker.addon.prt.bounces.shares import FEWEST, shares
from prt_baker.addon.prt.tracing.hemisphere import cosine_fibonacci

RAYS = cosine_fibonacci(256).astype(np.float32)


def places(count=50, seed=0):
    """Which of the rays of ``count`` places meet something: those to one side of a plane."""
    random = np.random.default_rng(seed)
    across = random.normal(size=(count, 3))
    across /= np.linalg.norm(across, axis=1, keepdims=True)
    return across @ RAYS.T > random.uniform(-0.5, 0.3, (count, 1))


def found(met, step):
    """The shares of every ``step``-th ray, and which of these meet something."""
    its = np.zeros(len(RAYS), bool)
    its[step // 2 :: step] = True
    others = met[:, ~its].astype(np.float32) @ np.insert(RAYS[~its], 0, 1, axis=1)
    return shares(met[:, its], RAYS[its], others), met[:, its], RAYS[its]


@pytest.mark.parametrize("step", [1, 2, 4])
def test_they_add_up_to_one_over_what_is_met_and_none_is_negative(step):
    its, met, _ = found(places(), step)
    assert its.min() >= 0
    np.testing.assert_allclose((its * met).sum(axis=1), 1, atol=1e-5)


def test_light_that_changes_evenly_is_found_better_by_far():
    met = places(200)
    met = met[met.sum(axis=1) > 100]
    towards = np.array([0.3, -0.5, 0.8])
    truth = (met * (1 + RAYS @ towards)).sum(axis=1) / met.sum(axis=1)
    its, some, directions = found(met, 4)
    light = 1 + directions @ towards
    plain = (some * light).sum(axis=1) / some.sum(axis=1)
    errors = [np.sqrt(((values - truth) ** 2).mean()) for values in (plain, (its * some) @ light)]
    assert errors[1] < 0.25 * errors[0]


def test_without_others_all_are_equal():
    met = places()
    its = shares(met, RAYS, np.zeros((len(met), 4), np.float32))
    np.testing.assert_allclose(its, np.repeat(1 / met.sum(axis=1)[:, None], 256, axis=1), rtol=1e-6)


def test_few_rays_have_equal_shares():
    met = np.zeros((1, 256), bool)
    met[0, : 2 * FEWEST] = True
    its, some, _ = found(met, 2)
    np.testing.assert_allclose(its[some], 1 / FEWEST, rtol=1e-6)


def test_what_is_packed_has_the_same_means():
    """Rays to the sky are left out, and places stay as they are without their neighbours."""
    met = places(70)
    met[3], met[7], met[:, 0] = True, False, True
    random = np.random.default_rng(0)
    entries = np.where(met, random.integers(0, 40, met.shape), -1).astype(np.int32)
    source_of = np.append(random.permutation(40), 40).astype(np.int32)
    table = random.random((41, 12), dtype=np.float32)
    table[-1] = 0
    others = np.zeros((len(met), 4), np.float32)
    expected = np.einsum("pw,pwk->pk", shares(met, RAYS, others) * met, table[source_of[entries]])

    def means(rows):
        packed = Chunk(np.arange(70)[rows], others[rows], entries[rows], RAYS).packed()
        packed.translate(source_of)
        return packed.means(table)

    np.testing.assert_allclose(means(slice(None)), expected, rtol=1e-5)
    np.testing.assert_array_equal(means(slice(20, 50)), means(slice(None))[20:50])
    assert means(slice(0)).shape == (0, 12)
