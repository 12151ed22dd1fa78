"""Points inside of other things are found, and don't darken what is seen beside them."""

import numpy as np
import pytest
import shapes
from prt_baker.addon.prt.job import Job, LightSource, Settings
from prt_baker.addon.prt.run import run
from prt_baker.addon.prt.steps import value_of
from prt_baker.addon.prt.surface import points
from prt_baker.addon.prt.tracing import buried, rays


def floor_and_crate(inward=False):
    floor = shapes.grid([-2, -2, 0], [4, 0, 0], [0, 4, 0], 33)
    vertices, triangles = shapes.box(1.0, 4, inward)
    crate = (np.add(vertices, (0, 0, 0.4)), triangles)
    return shapes.receiver(*floor), *shapes.join(floor, crate)


class Counting(rays.Sky):
    """The open sky, counting who looks for backs."""

    def __init__(self):
        self.rays = 0

    def meets_back(self, origins, directions):
        self.rays += len(directions)
        return super().meets_back(origins, directions)


def inside(places):
    return np.abs(places[:, :2]).max(axis=1) < 0.5


def test_the_backs_of_triangles_are_told_from_their_fronts():
    vertices, triangles = shapes.grid([-1, -1, 1], [2, 0, 0], [0, 2, 0], 1)  # faces up
    sky = rays.Triangles(vertices, triangles)
    origins = np.array([[0.3, 0.2, 0], [0.3, 0.2, 2], [5, 5, 0]], np.float32)
    directions = np.array([[0, 0, 1], [0, 0, -1], [0, 0, 1]], np.float32)
    assert sky.meets_back(origins, directions).tolist() == [True, False, False]


def test_points_in_a_crate_are_buried_and_those_in_a_room_are_not():
    receiver, vertices, triangles = floor_and_crate()
    where = points.distinct_points(receiver)
    sky = rays.occlusion(vertices, triangles)
    dark = np.zeros((len(where.origins), 9), np.float32)
    found = buried.buried(where.origins, where.normals, dark, sky)
    np.testing.assert_array_equal(found, inside(where.origins))
    _, vertices, triangles = floor_and_crate(inward=True)
    sky = rays.occlusion(vertices, triangles)
    assert not buried.buried(where.origins, where.normals, dark, sky).any()


def test_what_sees_the_sky_is_never_buried():
    receiver, vertices, triangles = floor_and_crate()
    where = points.distinct_points(receiver)
    lit = np.ones((len(where.origins), 9), np.float32)
    sky = rays.occlusion(vertices, triangles)
    assert not buried.buried(where.origins, where.normals, lit, sky).any()


def bake(fit):
    receiver, vertices, triangles = floor_and_crate()
    settings = Settings(verify_points=1000, verify_rays=2048, fit=fit)
    job = Job("bake", settings, LightSource(), (receiver,), vertices, triangles)
    steps = run(job)
    return receiver, value_of(steps)


@pytest.fixture(scope="module")
def baked():
    return bake(fit=False)


@pytest.fixture(scope="module")
def fitted():
    return bake(fit=True)


def test_the_first_ring_takes_what_lies_outside(baked):
    receiver, results = baked
    shown = results.receivers[0].at_elements(results.receivers[0].transfer)[:, 0, 0]
    places = receiver.vertices[receiver.corner_vertices]
    border = inside(places) & (np.abs(places[:, :2]).max(axis=1) > 0.4)
    deep = np.abs(places[:, :2]).max(axis=1) < 0.2
    outside = shown[~inside(places)]
    assert border.any()
    assert shown[border].min() >= outside.min()
    assert shown[border].max() <= outside.max()
    assert deep.any()
    assert not shown[deep].any()
    assert results.report["objects"][0]["buried_points"] == 64


def test_a_fit_darkens_towards_the_crate_and_no_further(fitted):
    """The floor at the foot of a wall sees half of the sky; the values of a crossing triangle's
    inner corners go on from there."""
    receiver, results = fitted
    shown = results.receivers[0].at_elements(results.receivers[0].transfer)[:, 0, 0]
    places = receiver.vertices[receiver.corner_vertices]
    border = inside(places) & (np.abs(places[:, :2]).max(axis=1) > 0.4)
    deep = np.abs(places[:, :2]).max(axis=1) < 0.2
    assert shown[border].min() > 0.25 * shown.max()
    assert not shown[deep].any()


def on_surface(results):
    return results.report["objects"][0]["measured_error"]["on_surface"]


def test_unseen_points_do_not_count_as_errors(baked, fitted):
    assert on_surface(baked[1]) < 0.1
    assert on_surface(fitted[1]) < 1.05 * on_surface(baked[1])


def test_the_rays_that_look_for_backs_are_known():
    some = np.array([[0.0, 0], [1, 0], [0, 0]], np.float32)
    sky = Counting()
    buried.buried(np.zeros((3, 3), np.float32), np.eye(3, dtype=np.float32), some, sky)
    assert sky.rays == buried.rays_for(some) == 2 * buried.RAYS
