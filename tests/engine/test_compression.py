"""Clustered principal components: what they leave out, what they weigh, and who chooses."""

from itertools import pairwise

import numpy as np
import pytest
from prt_baker.addon import engine
from prt_baker.addon.prt import sh
from prt_baker.addon.prt.compression import choosing, importance, pca, request
from prt_baker.addon.prt.compression.choosing import Part
from prt_baker.addon.prt.job import Peak
from prt_baker.addon.prt.layout import Layout, Values, pack
from prt_baker.addon.prt.light import residual

F = 12


def smooth(count=3000, floats=F, seed=0):
    """Points on a bent surface of three dimensions."""
    rng = np.random.default_rng(seed)
    places = rng.uniform(size=(count, 3))
    return np.sin(places @ rng.normal(0, 2, (3, floats))).astype(np.float32)


def coded(values, clusters, weights, matters=None):
    matters = np.ones(values.shape[1]) if matters is None else matters
    return pca.encoded(values, matters, pca.fitted(values, matters, clusters, weights, 0))


def error(values, codes):
    return np.sqrt(np.square(codes.decoded() - values).mean() / np.square(values).mean())


def test_one_cluster_is_plain_pca():
    """It leaves what numpy's singular values leave."""
    values = smooth()
    for weights in (1, 4, 8):
        left = np.linalg.svd(values - values.mean(axis=0), compute_uv=False)[weights:]
        expected = np.sqrt(np.square(left).sum() / np.square(values).sum())
        assert error(values, coded(values, 1, weights)) == pytest.approx(expected, rel=1e-3)


def test_as_many_weights_as_floats_leave_the_rounding():
    values = smooth()
    codes = coded(values, 16, F)
    step = np.abs(codes.directions).sum(axis=1).max() / 65534
    assert np.abs(codes.decoded() - values).max() <= step + 1e-6


def test_weights_fit_a_normalized_short():
    codes = coded(smooth(), 16, 3)
    assert np.abs(codes.weights).max() == 1
    steps = codes.weights * 32767
    np.testing.assert_allclose(steps, np.rint(steps), atol=1e-2)
    assert set(codes.clusters) == set(range(len(codes.means)))


def test_more_clusters_and_more_weights_leave_less():
    values = smooth(20000)
    by_clusters = [error(values, coded(values, k, 3)) for k in (1, 4, 16)]
    by_weights = [error(values, coded(values, 16, n)) for n in (1, 3, 5, 7)]
    for errors in (by_clusters, by_weights):
        assert all(b < 0.8 * a for a, b in pairwise(errors))


def test_clusters_that_lie_apart_are_found():
    """Four flat patches of two dimensions each: nothing is left but the rounding."""
    rng = np.random.default_rng(1)
    patches = [
        rng.normal(0, 20, F) + rng.uniform(-1, 1, (400, 2)) @ rng.normal(size=(2, F))
        for _ in range(4)
    ]
    values = np.concatenate(patches).astype(np.float32)
    assert error(values, coded(values, 4, 2)) < 1e-5


def test_what_matters_more_is_off_by_less():
    values, matters = smooth(), np.ones(F)
    matters[3] = 100
    even, uneven = (coded(values, 4, 3, m).decoded() - values for m in (np.ones(F), matters))
    assert np.abs(uneven[:, 3]).mean() < 0.05 * np.abs(even[:, 3]).mean()


def test_what_does_not_matter_is_its_mean():
    values, matters = smooth(), np.ones(F)
    matters[5] = 0
    found = coded(values, 4, 3, matters).decoded()
    np.testing.assert_allclose(found[:, 5], values[:, 5].mean(), atol=1e-6)


@pytest.mark.parametrize("values", [smooth(1), smooth(2), np.zeros((50, F), np.float32)])
def test_few_points_and_equal_ones_are_no_trouble(values):
    codes = coded(values, 16, 3)
    assert np.isfinite(codes.decoded()).all()
    np.testing.assert_allclose(codes.decoded(), values, atol=1e-4)


def test_the_same_seed_gives_the_same_bits():
    values = smooth()
    first, second = (coded(values, 16, 3) for _ in range(2))
    for name in ("clusters", "weights", "means", "directions"):
        np.testing.assert_array_equal(getattr(first, name), getattr(second, name))


def part(values):
    rng = np.random.default_rng(2)
    return Part(values, np.ones(F), rng.normal(0, 0.3, (F, 3)))


@pytest.mark.parametrize("tolerance", [0.1, 0.03, 0.013])
def test_the_smallest_within_the_tolerance_is_chosen(tolerance):
    values = smooth(9000)
    codes, report = choosing.chosen(part(values), tolerance, 0)
    found = report["chosen"]
    assert found["error"] <= tolerance
    assert (len(codes.means), codes.weights.shape[1]) == (found["clusters"], found["weights"])
    assert found == report["tried"][-1]
    sizes = [one["bytes"] for one in report["tried"][:-1]]
    assert sizes == sorted(sizes)
    assert all(one["error"] > tolerance for one in report["tried"][:-1])
    off = (codes.decoded() - values) @ part(values).radiance
    rms = np.sqrt(np.square(values @ part(values).radiance).mean())
    assert np.sqrt(np.square(off).mean()) / rms <= tolerance


def test_where_nothing_is_gained_nothing_is_coded():
    noise = np.random.default_rng(0).normal(size=(2000, F)).astype(np.float32)
    codes, report = choosing.chosen(part(noise), 0.001, 0)
    assert codes is None
    assert report["chosen"] is None
    assert report["tried"]


def random_bake(layout, count=500):
    rng = np.random.default_rng(3)
    return Values(
        rng.normal(size=(count, layout.channels, layout.order**2)).astype(np.float32),
        rng.normal(size=(count, layout.turns, 3)).astype(np.float32),
        rng.uniform(size=(count, layout.lights)).astype(np.float32),
    )


PEAK = Peak((0.6, 0.0, 0.8), (3.0, 2.0, 1.0), 0.1)
LAYOUTS = [Layout(3, turns=1), Layout(2, 3, 12, 1), Layout(5, 1, 1, 1)]


@pytest.mark.parametrize("layout", LAYOUTS, ids=str)
def test_the_radiance_of_floats_is_that_of_the_bake(layout):
    values = random_bake(layout)
    baked = np.random.default_rng(4).normal(size=(25, 3))
    peaks = (PEAK,) * layout.lights
    terms = residual.terms(baked, baked, layout.turns, peaks)
    truth = residual.shaded(values.transfer, baked) + residual.beyond(values, terms)
    lights = np.array([PEAK.irradiance]) / np.pi
    by = importance.radiance_of(layout.slots, baked, residual.peaks_sh(peaks), lights)
    np.testing.assert_allclose(pack(layout, values) @ by, truth, atol=1e-4)


@pytest.mark.parametrize("channels", [1, 3])
def test_importance_is_the_error_over_all_turns_of_the_light(channels):
    layout = Layout(3, channels)
    rng = np.random.default_rng(5)
    baked = rng.normal(size=(25, 3)) * np.array([3, *[1] * 24])[:, None]
    matters = importance.importance_of(layout.slots, baked, np.empty((0, 3)))
    off = rng.normal(size=(len(layout.slots))).astype(np.float32)
    predicted = np.sqrt(np.square(off * matters).sum())
    transfer = np.zeros((1, channels, 9))
    for place, name in enumerate(layout.slots):
        if name:
            number = int(name[1:].rstrip("rgb"))
            transfer[0, "rgb".find(name[-1]) if channels == 3 else 0, number] = off[place]
    squares = []
    for _ in range(3000):
        q, r = np.linalg.qr(rng.normal(size=(3, 3)))
        turn = q * np.sign(np.diag(r))
        squares.append(np.square(residual.shaded(transfer, sh.rotate(baked, turn))).mean())
    spare = np.square(importance.SPARE * np.abs(baked[0]).max() * off).sum()
    spare *= 1 / 3 if channels == 3 else 1
    assert predicted**2 - spare == pytest.approx(np.mean(squares), rel=0.1)


def test_the_engine_codes_in_a_process_of_its_own(tmp_path):
    parts = [part(smooth()), part(smooth(20, seed=1)), part(smooth(seed=2))]
    asked = request.Request(parts, 0.05)
    answers = engine.compressed(asked)
    for one, (codes, report) in zip(parts, answers, strict=True):
        here, expected = choosing.chosen(one, 0.05, 0)
        assert report == expected
        assert (codes is None) == (here is None)
        if codes is not None:
            np.testing.assert_array_equal(codes.decoded(), here.decoded())
