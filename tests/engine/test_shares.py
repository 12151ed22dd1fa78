"""What the rays that are looked at stand for."""

import numpy as np
import pytest
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
