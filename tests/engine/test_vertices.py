"""Values at vertices out of equal rays: fitted to samples inside the triangles, or traced there."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
import shapes
from prt_baker.addon.prt import sh
from prt_baker.addon.prt.job import Settings
from prt_baker.addon.prt.steps import value_of
from prt_baker.addon.prt.surface.points import Points, Surface, distinct_points, element_triangles
from prt_baker.addon.prt.surface.samples import random_places, starts
from prt_baker.addon.prt.tracing import rays, transfer
from prt_baker.addon.prt.tracing.buried import buried
from prt_baker.addon.prt.vertex import solver, traced, values
from prt_baker.addon.prt.vertex.fit_mesh import interpolated
from prt_baker.addon.prt.vertex.parts import parts_of


def folded_sheet(count):
    """A sheet of count² quads with folds that shade each other."""
    (x, y, _), triangles = np.transpose((g := shapes.grid([-1, -1, 0], [2, 0, 0], [0, 2, 0],
                                                          count))[0]), g[1]  # fmt: skip

    def height(x, y):
        first = 0.16 * np.sin(11 * x + 2 * np.sin(3 * y))
        return first + 0.1 * np.sin(9 * y + 3 * np.cos(4 * x))

    e = 1e-5
    slopes = (height(x + e, y) - height(x - e, y), height(x, y + e) - height(x, y - e))
    normals = np.stack([-slopes[0] / (2 * e), -slopes[1] / (2 * e), np.ones_like(x)], axis=1)
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    sheet = np.stack([x, y, height(x, y)], axis=1)
    return shapes.receiver(sheet, triangles, normals), sheet, triangles


def floor_with_boxes(count):
    """A flat floor of count² quads, with the shadows' edges of what stands on it."""
    floor = shapes.grid([-2, -2, 0], [4, 0, 0], [0, 4, 0], count)
    cube = shapes.box(1.0, 2, inward=False)
    crates = [
        (cube[0] * size + place, cube[1])
        for size, place in ((0.5, (0.6, 0.4, 0.25)), (0.8, (-0.7, -0.5, 0.4)), (0.4, (-1, 1, 0.2)))
    ]
    return shapes.receiver(*floor), *shapes.join(floor, *crates)


SCENES = {
    "knot": lambda: shapes.knot_scene(600, 24),
    "sheet": lambda: folded_sheet(60),
    "floor": lambda: floor_with_boxes(40),
}


class Bench:
    """A scene, the truth at random places of its surface, and what it takes to come near."""

    def __init__(self, receiver, occluders, triangles, count=600, truth=4096):
        self.receiver, self.sky = receiver, rays.occlusion(occluders, triangles)
        self.points = distinct_points(receiver)
        self.parts = parts_of(receiver, self.points, may_fit=False)
        surface, rows = Surface.of(receiver), element_triangles(receiver)
        places = random_places(surface.areas, count, 3)
        origins, normals = starts(surface, rows, receiver.normals, places)
        self.rows, self.places = self.points.element_points[rows], places
        self.truth = self.trace(Settings(seed=9))(origins, normals, truth)
        places = origins.astype(np.float32), normals.astype(np.float32)
        self.seen = ~buried(*places, self.truth, self.sky)

    def trace(self, settings, extra=0):
        def trace(origins, normals, count):
            values = np.empty((len(origins), settings.order**2), np.float32)
            where = Points(
                np.asarray(origins, np.float32), np.asarray(normals, np.float32), np.empty(0, int)
            )
            value_of(transfer.trace_all(where, self.sky, replace(settings, rays=count), values))
            return np.concatenate(
                [values, *[values[:, :1] * (k + 1) for k in range(extra)]], axis=1
            )

        return trace

    def solve(self, count, noise, extra=0, **settings):
        settings = Settings(**{"threads": 2, **settings})
        trace = self.trace(settings, extra)

        def steps(origins, normals, rays):
            yield 0
            values = trace(origins, normals, rays)
            yield len(origins) * rays
            return values

        solved = solver.solve(
            self.receiver, self.points, steps, self.sky, settings, rays=count, noise=noise
        )
        return value_of(solved)

    def error(self, values):
        corners = self.rows[self.places.triangles]
        shown = np.einsum("pk,pkc->pc", self.places.barycentric, values[corners])
        return transfer.relative_rms(shown[self.seen, :9], self.truth[self.seen])


@cache
def bench(name):
    return Bench(*SCENES[name]())


NOISE = {("knot", 64): 0.06, ("knot", 256): 0.02, ("sheet", 64): 0.04, ("sheet", 256): 0.014,
         ("floor", 64): 0.03, ("floor", 256): 0.011}  # fmt: skip


@pytest.mark.parametrize(
    ("name", "count", "gain"),
    [
        ("knot", 64, 1.8),
        ("knot", 256, 1.5),
        ("sheet", 64, 1.0),
        ("sheet", 256, 1.0),
        ("floor", 64, 0.95),
        ("floor", 256, 0.95),
    ],
)
def test_a_fit_is_nearer_to_the_surface_at_equal_rays(name, count, gain):
    scene = bench(name)
    noise = NOISE[name, count]
    points, fitted = (scene.solve(count, noise, fit=fit) for fit in (False, True))
    assert fitted.entry["rays"] <= 1.002 * points.entry["rays"]
    assert scene.error(fitted.values) * gain < scene.error(points.values)


def test_the_errors_are_known():
    scene = bench("knot")
    for fit in (False, True):
        solved = scene.solve(256, NOISE["knot", 256], fit=fit)
        assert 0.6 < solved.entry["surface_error"] / scene.error(solved.values) < 1.5
        assert solved.entry["values"]["fitted"] == fit


def test_a_coarse_mesh_is_known_to_be_coarse():
    coarse = Bench(*shapes.knot_scene(60, 8))
    solved = coarse.solve(256, 0.02, fit=False)
    assert solved.entry["interpolation_error"] == pytest.approx(
        coarse.error(solved.values), rel=0.3
    )
    assert solved.entry["interpolation_error"] > 3 * solved.entry["estimated_error"]


@pytest.mark.parametrize(("name", "count"), [("knot", 64), ("floor", 256)])
def test_the_same_bits_for_any_threads_and_batches(name, count, monkeypatch):
    scene = bench(name)
    first = scene.solve(count, 0.03, threads=1).values
    monkeypatch.setattr(transfer, "BATCH_RAYS", 8192)
    np.testing.assert_array_equal(scene.solve(count, 0.03, threads=2).values, first)


def test_nothing_is_darker_than_black():
    scene = bench("floor")
    assert scene.solve(64, 0.03).values[:, 0].min() >= 0


def test_small_meshes_are_traced_at_their_points():
    scene = Bench(*shapes.knot_scene(24, 8), count=10)
    solved = scene.solve(64, 0.03)
    known = solved.traced.point >= 0
    assert solved.entry["values"] == {"points": 1, "fitted": 0}
    np.testing.assert_array_equal(
        solved.values[solved.traced.point[known]], solved.traced.values[known]
    )
    assert known.sum() == len(scene.points.origins)


def test_a_closed_room_stays_dark():
    room = shapes.box(2.0, 12)
    scene = Bench(shapes.receiver(*room), *room, count=10)
    assert not scene.solve(64, 0.03).values.any()


def test_dense_spots_do_not_overshoot():
    """Most of a UV sphere's vertices crowd at its poles, where hardly a sample lies."""
    theta = np.concatenate([np.linspace(1e-4, 0.02, 40), np.linspace(0.1, np.pi - 0.1, 30)])
    phi = np.linspace(0, 2 * np.pi, 40, endpoint=False)
    t, p = np.meshgrid(theta, phi, indexing="ij")
    normals = np.stack([np.sin(t) * np.cos(p), np.sin(t) * np.sin(p), np.cos(t)], axis=-1)
    i, j = np.meshgrid(np.arange(len(theta) - 1), np.arange(len(phi)), indexing="ij")
    a, b = i * len(phi) + j, i * len(phi) + (j + 1) % len(phi)
    lower = [k.reshape(-1) for k in (a, a + len(phi), b + len(phi), b)]
    triangles = np.concatenate([np.stack(lower[:3], 1), np.stack([lower[0], *lower[2:]], 1)])
    normals = normals.reshape(-1, 3)
    scene = Bench(shapes.receiver(normals, triangles, normals), normals, triangles, count=10)
    expected = sh.open_transfer(scene.points.normals, 3)
    for noise in (1e-3, 0.1):
        found = scene.solve(64, noise).values
        assert np.abs(found - expected).max() < 0.03


def test_more_columns_are_solved_beside_the_transfer():
    scene = bench("floor")
    values = scene.solve(256, 0.011, extra=2).values
    assert values.shape == (len(scene.points.origins), 11)
    np.testing.assert_allclose(values[:, 10], 2 * values[:, 9], rtol=1e-3, atol=1e-4)
    assert np.abs(values[:, 9] - values[:, 0]).max() < 0.05


def eye_in_a_head(rings=28, height=0.78):
    """A ball that comes out of a larger one: few samples see anything."""
    ball, triangles, normals = shapes.sphere(rings, 2 * rings, 0.3)
    head, eye = shapes.sphere(48, 96)[:2], (ball + np.array([0, 0, height]), triangles)
    return Bench(shapes.receiver(*eye, normals), *shapes.join(eye, head))


def test_where_rays_start_follows_from_the_transfer_alone(monkeypatch):
    """Another HDRI, whose light is in the columns beside it, finds all of them on the tape."""
    scene = eye_in_a_head()
    alone, trace = scene.solve(64, 0.035).traced, scene.trace

    def beside(settings, extra):
        def found(origins, normals, count):
            values = trace(settings)(origins, normals, count)
            return np.concatenate([values, np.ones((len(values), extra), np.float32)], axis=1)

        return found

    monkeypatch.setattr(scene, "trace", beside)
    lit = scene.solve(64, 0.035, extra=3).traced
    np.testing.assert_array_equal(lit.origins, alone.origins)
    np.testing.assert_array_equal(lit.rays, alone.rays)


def test_where_a_fit_predicts_samples_badly_points_are_shown_as_they_are(monkeypatch):
    scene = eye_in_a_head(16, 0.9)
    solved = scene.solve(64, 0.03)
    monkeypatch.setattr(values, "WORSE", 1e9)
    fitted = scene.solve(64, 0.03)
    assert (solved.entry["values"]["fitted"], fitted.entry["values"]["fitted"]) == (0, 1)
    assert solved.entry["rays"] == fitted.entry["rays"]
    assert scene.error(solved.values) < scene.error(fitted.values)


def test_points_without_a_fit_show_what_was_traced_there(monkeypatch):
    scene, noise = bench("sheet"), NOISE["sheet", 64]
    assert scene.solve(64, noise).entry["values"]["fitted"] == 1
    monkeypatch.setattr(values, "WORSE", 0)
    solved = scene.solve(64, noise)
    at = solved.traced.point
    assert solved.entry["values"]["fitted"] == 0
    shown, found = solved.values[at[at >= 0]], solved.traced.values[at >= 0]
    seen = shown.any(axis=1) & found.any(axis=1)
    np.testing.assert_array_equal(shown[seen], found[seen])
    error = scene.error(solved.values)
    assert 0.7 < solved.entry["surface_error"] / error < 1.4


def test_every_place_says_how_it_was_traced():
    scene = bench("sheet")
    solved = scene.solve(256, 0.014)
    places = solved.traced
    assert (places.rays >= solver.MIN_RAYS).all()
    np.testing.assert_allclose(places.noisier, (256 / places.rays) ** traced.FALL)
    inside = places.point < 0
    np.testing.assert_array_equal(places.places.barycentric[~inside].max(axis=1), 1)
    shown = interpolated(scene.parts.mesh, places.places, scene.points.origins)
    assert np.linalg.norm(shown - places.origins, axis=1).max() < 0.02
