"""The error that was asked for is the error that comes out."""

import numpy as np
import pytest
import shapes
from prt_baker.addon.prt.job import Settings
from prt_baker.addon.prt.steps import value_of
from prt_baker.addon.prt.surface import points
from prt_baker.addon.prt.tracing import rays, tolerance, transfer


def boxes_on_a_ground():
    rng = np.random.default_rng(0)
    ground = shapes.grid([-10, -10, 0], [20, 0, 0], [0, 20, 0], 40)
    box, faces = shapes.box(1.0, 3, inward=False)
    places = [box * rng.uniform(0.3, 1, 3) + [*rng.uniform(-9, 9, 2), 0.4] for _ in range(40)]
    vertices, triangles = shapes.join(ground, *((place, faces) for place in places))
    return shapes.receiver(vertices, triangles), vertices, triangles


SCENES = {"knot": lambda: shapes.knot_scene(300, 24), "boxes": boxes_on_a_ground}


@pytest.fixture(scope="module", params=SCENES)
def scene(request):
    """Points of a scene, some of them with their true transfer, and its occlusion."""
    receiver, vertices, triangles = SCENES[request.param]()
    where, sky = points.distinct_points(receiver), rays.occlusion(vertices, triangles)
    some = slice(3, None, len(where.origins) // 700)
    few = points.Points(where.origins[some], where.normals[some], where.element_points[:0])
    truth = np.empty((len(few.origins), 9), np.float32)
    value_of(transfer.trace_all(few, sky, Settings(rays=16384, seed=9), truth))
    return where, few, truth, sky


@pytest.mark.parametrize("asked", [0.05, 0.02, 0.01])
def test_the_measured_error_is_the_one_asked_for(scene, asked):
    where, few, truth, sky = scene
    settings = Settings(tolerance=asked)
    found = value_of(tolerance.effort(where, sky, settings, transfer.Shortcuts()))
    shortcuts = transfer.Shortcuts(pilot=found.pilot)
    result = np.empty_like(truth)
    value_of(transfer.trace_all(few, sky, Settings(rays=found.rays), result, shortcuts=shortcuts))
    assert 0.7 * asked < transfer.relative_rms(result, truth) < 1.15 * asked


def test_an_open_plane_needs_the_fewest_rays():
    where = points.distinct_points(shapes.receiver(*shapes.grid([0] * 3, [1, 0, 0], [0, 1, 0], 9)))
    settings = Settings(tolerance=0.01)
    found = value_of(tolerance.effort(where, rays.Sky(), settings, transfer.Shortcuts()))
    assert found.rays == tolerance.FEWEST


def test_nothing_is_asked_of_no_points():
    empty = points.Points(*np.empty((2, 0, 3), np.float32), np.empty(0, np.int32))
    settings = Settings(tolerance=0.01)
    assert value_of(tolerance.effort(empty, rays.Sky(), settings, transfer.Shortcuts())).cast == 0
