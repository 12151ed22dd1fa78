"""What points see, as coefficients: against closed forms, brute force, and the laws of a bake."""

from dataclasses import replace

import numpy as np
import pytest
import shapes
from prt_baker.addon.prt import job as jobs
from prt_baker.addon.prt import sh
from prt_baker.addon.prt.job import Settings
from prt_baker.addon.prt.run import run
from prt_baker.addon.prt.surface import points
from prt_baker.addon.prt.surface.points import Points
from prt_baker.addon.prt.tracing import hemisphere, rays, transfer, visibility
from prt_baker.addon.prt.verify import seen_by_brute_force
from test_baking import rays_of, sky
from test_horizon import horizon_of, open_field, rotation
from test_run import finish

NOTHING = np.empty(0, np.int32)


def seen_from(where, vertices, triangles, *, order=3, count=256, threads=1, **shortcuts):
    """Coefficients (P, v²) of what the points see, and their transfer (P, 9)."""
    out = np.empty((len(where.origins), 9 + order**2), np.float32)
    settings = Settings(rays=count, threads=threads)
    ways = transfer.Shortcuts(**shortcuts)
    scene = rays.occlusion(vertices, triangles)
    steps = transfer.trace_all(where, scene, settings, out, shortcuts=ways, visibility_order=order)
    finish(steps)
    return out[:, 9:], out[:, :9]


def everything(count, order=3):
    """The coefficients of V = 1."""
    return np.tile(np.eye(1, order**2) * np.sqrt(4 * np.pi), (count, 1))


@pytest.mark.parametrize("order", [1, 3, 5])
@pytest.mark.parametrize("count", [16, 100, 256])
def test_each_ray_stands_for_the_directions_that_are_nearest_to_it(count, order):
    """Piecewise constant functions are integrated exactly, up to how finely cells are measured."""
    weights = visibility.visibility_weights(count, order)
    np.testing.assert_allclose(weights.sum(axis=0), visibility._over_hemisphere(order), atol=1e-5)
    fine = visibility.even_hemisphere(50_000)
    owner = (fine @ hemisphere.cosine_fibonacci(count).T).argmax(axis=1)
    chosen = np.random.default_rng(0).random(count) < 0.4
    expected = sh.basis(fine[chosen[owner]], order).sum(axis=0) * 2 * np.pi / len(fine)
    np.testing.assert_allclose(weights[chosen].sum(axis=0), expected, atol=0.03)


def test_a_point_in_the_open_sees_all_of_the_sphere():
    normals = np.random.default_rng(1).normal(size=(50, 3))
    normals = np.float32(normals / np.linalg.norm(normals, axis=1, keepdims=True))
    where = Points(np.zeros((50, 3), np.float32), normals, NOTHING)
    for order in (2, 3, 4, 5):
        found, _ = seen_from(where, np.zeros((0, 3)), NOTHING.reshape(0, 3), order=order)
        np.testing.assert_allclose(found, everything(50, order), atol=2e-5)


def test_inside_a_closed_box_half_of_the_sphere_is_seen_the_own_horizon():
    room, triangles = shapes.box(2.0, 4)
    inside = points.distinct_points(shapes.receiver(room, triangles))
    found, _ = seen_from(inside, room, triangles)
    bands = np.arange(3)
    zonal = visibility._over_hemisphere(3)[sh.index(bands, 0)] * np.sqrt(
        4 * np.pi / (2 * bands + 1)
    )
    hidden = sh.basis(inside.normals, 3) * zonal[sh.bands(3)]
    np.testing.assert_allclose(found, everything(len(found)) - hidden, atol=1e-5)


@pytest.mark.parametrize("turn", [np.eye(3), rotation(3)])
def test_at_the_foot_of_an_endless_wall_a_quarter_of_the_sphere_is_hidden(turn):
    wall = shapes.grid([-5e3, 0, -5e3], [1e4, 0, 0], [0, 0, 1e4], 1)
    count = 64
    where = Points(
        np.float32(np.tile(turn @ [0, -1e-3, 0], (count, 1))),
        np.float32(np.tile(turn[:, 2], (count, 1))),
        NOTHING,
    )
    found, _ = seen_from(where, np.float32(wall[0] @ turn.T), wall[1], count=4096)
    fine = visibility.even_hemisphere(200_000)
    hidden = sh.basis(fine[fine[:, 1] > 0] @ turn.T, 3).sum(axis=0) * 2 * np.pi / len(fine)
    np.testing.assert_allclose(found, everything(count) - hidden, atol=0.02)
    np.testing.assert_allclose(found.mean(axis=0), everything(1)[0] - hidden, atol=2e-3)


def test_the_error_is_half_of_that_of_weights_of_one_over_cosine():
    """At equal rays, against brute force: on a knot over a floor and before a wall."""
    receiver, vertices, triangles = shapes.knot_scene(200, 16)
    where = points.distinct_points(receiver)
    chosen = np.random.default_rng(2).choice(len(where.origins), 150, replace=False)
    where = Points(where.origins[chosen], where.normals[chosen], NOTHING)
    scene, truth = rays.occlusion(vertices, triangles), np.empty((150, 9))
    settings = Settings(verify_rays=16384)
    finish(
        seen_by_brute_force(
            where.origins.astype(float), where.normals.astype(float), scene, settings, truth
        )
    )
    found, _ = seen_from(where, vertices, triangles)
    error = transfer.relative_rms(found, truth)
    assert error < 0.025
    bits = np.zeros((150, 32), np.uint8)
    seen_from(where, vertices, triangles, bits=bits)
    local = hemisphere.cosine_fibonacci(256)
    weights = sh.basis(local, 3) / local[:, 2:] * np.pi / 256
    visible = np.unpackbits(bits, axis=1).astype(np.float32)
    plain = visible @ weights - visible @ visibility.visibility_weights(256, 3)
    # turned with the point, so the errors' sizes can be compared without turning them
    assert np.sqrt((plain**2).mean()) > 1.4 * error * np.sqrt((truth**2).mean())


def test_the_error_falls_with_the_rays():
    receiver, vertices, triangles = shapes.knot_scene(100, 12)
    where = points.distinct_points(receiver)
    truth, _ = seen_from(where, vertices, triangles, count=4096)
    errors = [
        transfer.relative_rms(seen_from(where, vertices, triangles, count=n)[0], truth)
        for n in (64, 256, 1024)
    ]
    assert errors[1] < 0.55 * errors[0]
    assert errors[2] < 0.55 * errors[1]


def test_what_is_known_without_a_ray_is_seen_too():
    receiver, vertices, triangles = open_field()
    where, found = horizon_of(receiver, vertices, triangles)
    plain, _ = seen_from(where, vertices, triangles)
    short, _ = seen_from(where, vertices, triangles, horizon=found)
    np.testing.assert_allclose(short, plain, atol=1e-5)
    ball, faces, normals = shapes.sphere(16, 32)
    alone, sky_of = horizon_of(shapes.receiver(ball, faces, normals), ball, faces)
    seen, _ = seen_from(alone, ball, faces, horizon=sky_of)
    np.testing.assert_allclose(seen, everything(len(seen)), atol=2e-5)


def test_same_bits_for_any_threads_and_any_batch_size(monkeypatch):
    receiver, vertices, triangles = open_field()
    where, found = horizon_of(receiver, vertices, triangles)
    results = []
    for size, threads in ((1, 2), (5000, 1), (1 << 20, 2)):
        monkeypatch.setattr(transfer, "BATCH_RAYS", size)
        results.append(seen_from(where, vertices, triangles, threads=threads, horizon=found))
    for seen, its_transfer in results[1:]:
        np.testing.assert_array_equal(seen, results[0][0])
        np.testing.assert_array_equal(its_transfer, results[0][1])


@pytest.fixture
def job(tmp_path):
    """A ball over a floor, both on vertices, the ball fine enough to be fitted."""
    ball, faces, normals = shapes.sphere(24, 48)
    floor = shapes.grid([-3, -3, -1.05], [6, 0, 0], [0, 6, 0], 20)
    vertices, triangles = shapes.join((ball, faces), floor)
    body = replace(shapes.receiver(ball, faces, normals, "ball"), vertices=ball)
    ground = replace(shapes.receiver(*floor, name="floor"), vertices=floor[0])
    return jobs.Job(
        settings=jobs.Settings(rays=64, cache=str(tmp_path), visibility_order=3),
        light=jobs.LightSource(pixels=sky(0)),
        receivers=(body, ground),
        occluder_vertices=vertices,
        occluder_triangles=triangles,
        occluder_starts=np.array([0, len(faces), len(triangles)]),
    )


def with_settings(job, **changes):
    return replace(job, settings=replace(job.settings, **changes))


def test_without_it_nothing_is_computed_or_stored(job, monkeypatch):
    """And with it, what a point traces and stores besides is the same to the bit."""
    plain = with_settings(job, cache="", fit=False)
    _, seen = finish(run(plain))
    monkeypatch.setattr(transfer, "VisibilitySet", None)
    _, unseen = finish(run(with_settings(plain, visibility_order=0)))
    assert rays_of(seen) == rays_of(unseen)
    for one, other in zip(seen.receivers, unseen.receivers, strict=True):
        assert one.visibility_sh.shape == (len(one.transfer), 9)
        assert other.visibility_sh.shape == (len(one.transfer), 0)
        for name in ("transfer", "residual", "visibility", "element_points"):
            np.testing.assert_array_equal(getattr(one, name), getattr(other, name))


def test_another_order_of_it_costs_no_ray_for_the_transfer(job):
    _, first = finish(run(job))
    _, again = finish(run(job))
    assert rays_of(again) == [0, 0]
    other = with_settings(job, visibility_order=2)
    _, cached = finish(run(other))
    _, fresh = finish(run(with_settings(other, cache="")))
    for entry in cached.report["objects"]:
        assert entry["rays"] == entry["map_rays"]
    for many, kept, new in zip(first.receivers, cached.receivers, fresh.receivers, strict=True):
        np.testing.assert_array_equal(kept.visibility_sh, new.visibility_sh)
        scale = np.abs(many.visibility_sh[:, :4]).max()
        np.testing.assert_allclose(kept.visibility_sh, many.visibility_sh[:, :4], atol=0.02 * scale)


@pytest.mark.parametrize("bounces", [0, 1])
def test_verify_measures_it_at_vertices(job, bounces):
    grey = np.full((len(job.occluder_triangles), 3, 3), 0.5, np.float32)
    exact = with_settings(replace(job, occluder_albedo=grey), rays=256, bounces=bounces, cache="")
    _, results = finish(run(with_settings(exact, verify_points=60, verify_rays=2048)))
    for entry in results.report["objects"]:
        assert 0 < entry["measured_error"]["visibility_at_points"] < 0.03
        assert 0 < entry["measured_error"]["visibility_on_surface"] < 0.1


def test_it_lies_in_textures_too(job):
    textured = replace(
        with_settings(job, resolution=64, verify_points=40, verify_rays=1024),
        receivers=tuple(replace(one, carrier="texture") for one in job.receivers),
    )
    _, results = finish(run(textured))
    [atlas] = results.atlases
    assert atlas.names[-9:] == tuple(f"V{i}" for i in range(9))
    first = atlas.image[..., -9]
    assert 0 < first.min() <= first.max() < 1.02 * np.sqrt(4 * np.pi)
    for entry in results.report["objects"]:
        assert 0 < entry["measured_error"]["visibility_on_surface"] < 0.1
    _, again = finish(run(with_settings(textured, verify_points=0)))
    np.testing.assert_array_equal(again.atlases[0].image, atlas.image)
