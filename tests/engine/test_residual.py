"""How much of a residual is shown: all of it where it was baked, none under another light."""

from itertools import pairwise
from math import cos, pi, sin

import numpy as np
import pytest
from prt_baker.addon.prt import sh
from prt_baker.addon.prt.job import Peak
from prt_baker.addon.prt.light import residual

DEGREES = pi / 180
SUN = Peak((0.48, -0.6, 0.64), (30.0, 20.0, 10.0), 0.1)


def sky(seed=0):
    """A light (25, 3) with a direction, unlike in its channels."""
    rng = np.random.default_rng(seed)
    light = rng.normal(0, 0.3, (25, 3))
    light[0] = 4
    light[1:4] += sh.basis([0.6, 0.0, 0.8], 2)[1:4, None] * (3, 2, 1)
    return light


def about_z(angle):
    return np.array([[cos(angle), -sin(angle), 0], [sin(angle), cos(angle), 0], [0, 0, 1]])


def test_the_formula_word_for_word():
    now, baked = sky(1), sky(2)
    a, b = now[1:9].ravel(), baked[1:9].ravel()
    rho = a @ b / np.sqrt(a @ a) / np.sqrt(b @ b)
    ratio = np.sqrt((now**2).sum(axis=0) / (baked**2).sum(axis=0))
    np.testing.assert_allclose(residual.weight(now, baked), ratio * rho**16, rtol=1e-12)


def test_all_of_it_is_shown_where_it_was_baked():
    np.testing.assert_allclose(residual.weight(sky(), sky()), 1, rtol=1e-12)


@pytest.mark.parametrize("strength", [0.0, 1e-3, 2.5, 1e4])
def test_it_is_as_strong_as_the_light(strength):
    np.testing.assert_allclose(residual.weight(strength * sky(), sky()), strength, rtol=1e-12)


def test_a_tint_tints_it():
    tint = np.array([1.05, 1.0, 0.9])
    weight = residual.weight(tint * sky(), sky())
    np.testing.assert_allclose(weight / weight[1], tint, rtol=1e-12)
    assert weight[1] > 0.95


def test_a_channel_that_was_dark_has_none():
    baked = sky() * (1, 0, 1)
    now = sky()
    assert residual.weight(now, baked)[1] == 0
    assert residual.weight(now, np.zeros((25, 3))).tolist() == [0, 0, 0]
    assert residual.weight(np.zeros((25, 3)), baked).tolist() == [0, 0, 0]


def test_the_opposite_light_has_none():
    turned = sky()
    turned[1:9] *= -1
    assert residual.weight(turned, sky()).tolist() == [0, 0, 0]


def test_it_falls_as_the_world_turns():
    weights = [
        residual.weight(sh.rotate(sky(), about_z(angle * DEGREES)), sky())[0]
        for angle in range(0, 91, 5)
    ]
    assert weights[0] == pytest.approx(1)
    assert all(later < before for before, later in pairwise(weights))
    assert weights[-1] < 1e-3


def test_light_without_a_direction_agrees_with_its_like_alone():
    constant = np.zeros((25, 3))
    constant[0] = 2
    np.testing.assert_allclose(residual.weight(3 * constant, constant), 3)
    assert residual.weight(sky(), constant).tolist() == [0, 0, 0]
    assert residual.weight(constant, sky()).tolist() == [0, 0, 0]


@pytest.mark.parametrize("angle", [0.0, 0.3, 2.0, -1.0, 7.0])
def test_turned_is_a_rotation_about_z(angle):
    expected = sh.rotate(sky(), about_z(angle))
    np.testing.assert_allclose(residual.turned(sky(), angle), expected, atol=1e-12)


@pytest.mark.parametrize("angle", np.linspace(0, 2 * pi, 17)[:-1])
@pytest.mark.parametrize("seed", range(4))
def test_the_angle_is_that_of_the_turned_world(angle, seed):
    found = residual.turn_angle(2 * residual.turned(sky(seed), angle), sky(seed))
    assert abs((found - angle + pi) % (2 * pi) - pi) < 1e-6


def test_the_angle_is_the_best_there_is():
    now, baked = sky(3), sky(4)
    best = residual.turned(baked, residual.turn_angle(now, baked))[1:9]
    others = [residual.turned(baked, a)[1:9] for a in np.linspace(0, 2 * pi, 721)]
    assert (best * now[1:9]).sum() >= max((other * now[1:9]).sum() for other in others)


def test_one_turn_is_the_plain_rule():
    weights = residual.turn_weights(sky(1), sky(), 1)
    np.testing.assert_array_equal(weights, residual.weight(sky(1), sky())[None])
    assert residual.turn_weights(sky(1), sky(), 0).shape == (0, 3)


@pytest.mark.parametrize("turns", [2, 3, 12, 24])
def test_each_residual_alone_is_shown_at_its_turn(turns):
    for k in range(turns):
        weights = residual.turn_weights(residual.turned(sky(), 2 * pi * k / turns), sky(), turns)
        expected = np.zeros((turns, 3))
        expected[k] = 1
        np.testing.assert_allclose(weights, expected, atol=1e-5)


def test_half_of_each_is_shown_between_two_turns():
    weights = residual.turn_weights(residual.turned(sky(), 2 * pi * 4.5 / 12), sky(), 12)
    np.testing.assert_allclose(weights[4:6], 0.5, atol=1e-6)
    np.testing.assert_allclose(np.delete(weights, [4, 5], axis=0), 0, atol=1e-6)


@pytest.mark.parametrize("turns", [2, 12])
def test_turned_weights_follow_without_a_jump_and_come_round(turns):
    angles = np.linspace(0, 2 * pi, 361)
    weights = np.array(
        [residual.turn_weights(residual.turned(sky(), a), sky(), turns) for a in angles]
    )
    assert np.abs(np.diff(weights, axis=0)).max() < 1.01 * turns / 360
    np.testing.assert_allclose(weights[0], weights[-1], atol=1e-6)
    np.testing.assert_allclose(weights.sum(axis=1), 1, atol=1e-6)


def test_turned_residuals_fade_where_no_turn_helps():
    tilted = sh.rotate(sky(), [[0, 0, 1], [0, 1, 0], [-1, 0, 0]])
    assert residual.turn_weights(tilted, sky(), 12).max() < 0.05


def test_a_light_that_no_turn_changes_shows_the_first():
    light = np.zeros((25, 3))
    light[[0, 2, 6]] = 1
    np.testing.assert_allclose(residual.turn_weights(light, light, 4)[0], 1)


def test_a_disc_is_what_the_integral_over_it_says():
    z, rings = np.polynomial.legendre.leggauss(20)
    edge = cos(SUN.angular_radius)
    z, rings = edge + (z + 1) / 2 * (1 - edge), rings * (1 - edge) / 2
    phi = 2 * pi * np.arange(32) / 32
    sine = np.sqrt(1 - z**2)[:, None]
    local = [sine * np.cos(phi), sine * np.sin(phi), np.broadcast_to(z[:, None], (20, 32))]
    w = np.array(SUN.direction)
    u = np.cross(w, [0, 0, 1]) / np.linalg.norm(np.cross(w, [0, 0, 1]))
    directions = np.einsum("kzp,kc->zpc", local, [u, np.cross(w, u), w])
    solid_angle = np.repeat(rings[:, None] * 2 * pi / 32, 32, axis=1)
    facing = (solid_angle * (directions @ w)).sum()
    values = np.einsum("zp,zpi->i", solid_angle, sh.basis(directions, 5)) / facing
    found = residual.peaks_sh((SUN,))
    np.testing.assert_allclose(found, np.outer(values, SUN.irradiance), rtol=1e-9, atol=1e-9)


def test_a_peak_without_a_size_is_a_direction():
    point = Peak(SUN.direction, (1, 1, 1), 0.0)
    expected = sh.basis(SUN.direction, 5)
    np.testing.assert_allclose(residual.peaks_sh((point,))[:, 0], expected, atol=1e-12)


def test_peaks_are_cut_out_where_they_were_baked_and_put_back_elsewhere():
    baked = sky() + residual.peaks_sh((SUN,))
    here = residual.terms(baked, baked, 1, (SUN,))
    np.testing.assert_allclose(baked - here.cut_out, sky(), atol=1e-9)
    np.testing.assert_allclose(here.lights, [np.array(SUN.irradiance) / pi])
    away = residual.terms(residual.turned(baked, pi), baked, 1, (SUN,))
    np.testing.assert_allclose(away.cut_out, 0, atol=1e-3)
    np.testing.assert_allclose(away.lights, 0, atol=1e-3)


def test_peaks_fade_with_the_residual_of_the_world_as_it_was_baked():
    baked = sky() + residual.peaks_sh((SUN,))
    between = residual.terms(residual.turned(baked, pi / 12), baked, 12, (SUN,))
    np.testing.assert_allclose(between.residual[:2], 0.5, atol=1e-6)
    np.testing.assert_allclose(between.lights, [0.5 * np.array(SUN.irradiance) / pi], rtol=1e-5)
    alone = residual.terms(2 * baked, baked, 0, (SUN,))
    assert alone.residual.shape == (0, 3)
    np.testing.assert_allclose(alone.lights, [2 * np.array(SUN.irradiance) / pi])
