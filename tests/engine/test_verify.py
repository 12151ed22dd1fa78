"""What verifying measures: errors of the transfer and of the light, on the surface and where it was
traced."""

from dataclasses import replace

import numpy as np
import pytest
import shapes
from prt_baker.addon.prt import sh, verify
from prt_baker.addon.prt.job import Settings
from prt_baker.addon.prt.steps import value_of
from prt_baker.addon.prt.surface import points
from prt_baker.addon.prt.tracing import rays
from prt_baker.addon.prt.vertex.parts import joined
from prt_baker.addon.prt.vertex.traced import Traced

SETTINGS = Settings(verify_points=60, verify_rays=2048)
RADIANCE = np.random.default_rng(0).random((9, 3)) + np.eye(9, 3) * 4


def open_ball(factor=1.0, residual=0.0):
    """A ball under the open sky that shows ``factor`` times its transfer, and a residual."""
    vertices, triangles, normals = shapes.sphere(40, 80)
    ball = shapes.receiver(vertices, triangles, normals)
    transfer = factor * sh.open_transfer(ball.normals, 3)[:, None].astype(np.float32)
    shown = np.full((len(normals), 1, 3), residual, np.float32)
    return replace(ball, transfer=transfer, residual=shown)


def measured(ball, traced=None, light=None):
    where = points.distinct_points(ball)
    steps = verify.measure(ball, where, rays.Sky(), SETTINGS, traced=traced, light=light)
    return value_of(steps)


def exact(_, normals):
    """The exit radiance of a white open surface."""
    return np.maximum(sh.open_transfer(normals, 3) @ RADIANCE, 0)


def test_a_right_bake_has_no_error():
    found = measured(open_ball(), light=verify.Light(RADIANCE, exact))
    assert max(found.at_points, found.on_surface) < 0.01
    assert max(found.light_at_points, found.light_on_surface) < 0.01
    assert found.rays == found.points * SETTINGS.verify_rays


def test_without_a_light_there_is_no_error_of_it():
    found = measured(open_ball())
    assert found.light_at_points is None
    assert found.light_on_surface is None


@pytest.mark.parametrize("factor", [0.8, 1.3])
def test_the_histogram_counts_every_point_at_its_error(factor):
    found = measured(open_ball(factor))
    edges, counts = found.histogram["edges"], found.histogram["counts"]
    assert len(edges) == len(counts)
    assert sum(counts) == SETTINGS.verify_points
    middle = np.searchsorted(edges, abs(factor - 1), side="right") - 1
    assert counts[middle] > 0.6 * SETTINGS.verify_points
    assert found.on_surface == pytest.approx(abs(factor - 1), rel=0.02)


def test_the_residual_belongs_to_the_light():
    """A bake that shows half of the transfer and the rest of today's light as a residual."""
    constant = np.zeros((9, 3))
    constant[0] = 1
    gap = float(0.5 * sh.open_transfer([0, 0, 1.0], 1)[0])

    def sky(_, normals):
        return sh.open_transfer(normals, 3) @ constant

    found = measured(open_ball(0.5, gap), light=verify.Light(constant, sky))
    assert found.on_surface == pytest.approx(0.5, rel=0.02)
    assert max(found.light_on_surface, found.light_at_points) < 1e-3


def test_light_is_never_negative():
    found = measured(open_ball(1, -100), light=verify.Light(RADIANCE, exact))
    assert found.light_on_surface == pytest.approx(1)


def test_noise_is_measured_where_it_was_traced():
    """Not at the points, whose values may be a fit."""
    ball = open_ball(factor=2)
    normals = ball.normals[::7]
    origins = (normals * 1.001).astype(np.float32)
    none = np.full(len(normals), -1)
    values = sh.open_transfer(normals, 3).astype(np.float32)
    traced = Traced(origins, normals, values, none, joined([]), none, np.ones(len(normals)))
    found = measured(ball, traced)
    assert found.at_points < 0.01
    assert found.on_surface == pytest.approx(1, rel=0.02)
