"""What is known without a ray is what rays would have found."""

import numpy as np
import pytest
import shapes
from prt_baker.addon.prt import sh
from prt_baker.addon.prt.job import Settings
from prt_baker.addon.prt.steps import value_of
from prt_baker.addon.prt.surface import points
from prt_baker.addon.prt.tracing import (
    clusters,
    hemisphere,
    horizon,
    rays,
    rising,
    surroundings,
    transfer,
)
from prt_baker.addon.prt.tracing.flats import Parts, fewer


def rotation(seed):
    turn, _ = np.linalg.qr(np.random.default_rng(seed).normal(size=(3, 3)))
    return turn * np.sign(np.linalg.det(turn))


def open_field(turn=None):
    """A ground of 100 m with four balls above it: its points, and everything's arrays."""
    turn = np.eye(3) if turn is None else turn
    ground = shapes.grid([-50, -50, 0], [100, 0, 0], [0, 100, 0], 100)
    ball, faces, _ = shapes.sphere(16, 32)
    balls = [
        (ball + np.array([x, y, 1.2]), faces) for x, y in [(-20, 3), (10, 10), (5, -30), (25, -5)]
    ]
    vertices, triangles = shapes.join(ground, *balls)
    normals = np.tile(turn[:, 2], (len(ground[0]), 1))
    receiver = shapes.receiver(ground[0] @ turn.T, ground[1], normals)
    return receiver, (vertices @ turn.T).astype(np.float32), triangles


def clusters_of(vertices, triangles):
    """Of one thing."""
    return clusters.Clusters.of(
        Parts.of(vertices, triangles, [0, len(triangles)]), surroundings.FLOORS
    )


def horizon_of(receiver, vertices, triangles, starts=None):
    """The points and what is known of their surroundings."""
    where = points.distinct_points(receiver)
    starts = [0, len(triangles)] if starts is None else starts
    occluders = Parts.of(vertices, triangles, starts)
    around = surroundings.Surroundings(occluders, lambda: fewer(occluders))
    return where, around.horizon(receiver, where, len(where.origins), 256)


def traced(where, vertices, triangles, count=256, **shortcuts):
    """Transfer and counts of rays."""
    out = np.empty((len(where.origins), 9), np.float32)
    sky = rays.occlusion(vertices, triangles)
    steps = transfer.trace_all(
        where, sky, Settings(rays=count), out, shortcuts=transfer.Shortcuts(**shortcuts)
    )
    return out, value_of(steps)


@pytest.mark.parametrize("turn", [np.eye(3), *(rotation(seed) for seed in range(1, 9))])
def test_an_open_field_traces_little_and_loses_nothing(turn):
    receiver, vertices, triangles = open_field(turn)
    where, found = horizon_of(receiver, vertices, triangles)
    plain, all_rays = traced(where, vertices, triangles)
    short, few = traced(where, vertices, triangles, horizon=found)
    np.testing.assert_allclose(short, plain, atol=1e-6)
    assert few[transfer.CAST] < 0.04 * all_rays[transfer.CAST]
    assert few[transfer.CAST] + few[transfer.NOTHING_ABOVE] == all_rays[transfer.CAST]


def test_no_open_direction_is_blocked_over_rough_ground():
    """A folded sheet under a turned slab, flat enough for some of it to be open."""
    ground = shapes.grid([-5, -5, 0], [10, 0, 0], [0, 10, 0], 60)
    ground[0][:, 2] = 0.02 * np.sin(ground[0][:, 0]) * np.cos(ground[0][:, 1])
    slab = shapes.grid([1, 1, 1], [2, 0, 0.5], [0, 2, 0.2], 3)
    vertices, triangles = shapes.join(ground, slab)
    slopes = 0.02 * np.stack([np.cos(ground[0][:, 0]) * np.cos(ground[0][:, 1]),
                              -np.sin(ground[0][:, 0]) * np.sin(ground[0][:, 1])], 1)  # fmt: skip
    normals = np.concatenate([-slopes, np.ones((len(slopes), 1))], 1)
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    where = points.distinct_points(shapes.receiver(ground[0], ground[1], normals))
    found = horizon.Horizon(clusters_of(vertices, triangles))
    plain, _ = traced(where, vertices, triangles)
    short, few = traced(where, vertices, triangles, horizon=found)
    np.testing.assert_allclose(short, plain, atol=1e-6)
    assert few[transfer.NOTHING_ABOVE] >= 0


@pytest.mark.parametrize("turn", [np.eye(3), rotation(5)])
def test_each_sector_knows_what_stands_in_it(turn):
    """Beside a tall thin post only the directions towards it are in doubt."""
    ground = shapes.grid([-5, -5, 0], [10, 0, 0], [0, 10, 0], 40)
    post = shapes.grid([3, -0.1, 0.1], [0, 0.2, 0], [0, 0, 9], 6)
    vertices, triangles = shapes.join(ground, post)
    vertices = (vertices @ turn.T).astype(np.float32)
    found = horizon.Horizon(clusters_of(vertices, triangles))
    place = np.float32(turn @ [-2.0, 0, 0.001])
    normal = np.float32(turn[:, 2])
    shares = found.open_shares(place[None, None], normal[None, None])[0, 0]
    (matrix,) = hemisphere.frames(normal[None], np.zeros(1)).matrices()
    x, y, _ = matrix.T @ (turn @ [1.0, 0, 0])
    sector = int(np.arctan2(y, x) % (2 * np.pi) / (2 * np.pi) * rising.SECTORS)
    assert shares[sector] < 0.3
    others = np.delete(shares, [(sector + k) % rising.SECTORS for k in range(-2, 3)])
    assert (others == 1).all()


def test_a_horizon_that_would_save_nothing_is_left_out():
    receiver, vertices, triangles = shapes.knot_scene(200, 16)
    assert horizon_of(receiver, vertices, triangles)[1] is None


def test_a_convex_body_in_the_open_traces_no_ray():
    vertices, triangles = shapes.box(2.0, 4, inward=False)
    body = shapes.receiver(vertices + 3, triangles)
    below = shapes.grid([-9, -9, -9], [1, 0, 0], [0, 1, 0], 1)  # seen by its underside alone
    everything = shapes.join((body.vertices, triangles), below)
    where, found = horizon_of(body, *everything, [0, len(triangles), len(triangles) + 2])
    out, counts = traced(where, *everything, horizon=found)
    plain, _ = traced(where, *everything)
    np.testing.assert_allclose(out, plain, atol=1e-6)
    on_top = where.normals[:, 2] > 0.9
    np.testing.assert_allclose(out[on_top], sh.open_transfer(where.normals[on_top], 3), atol=1e-6)
    assert counts[transfer.CAST] < 0.4 * len(where.origins) * 256


def test_a_body_alone_is_a_closed_form():
    vertices, triangles = shapes.box(2.0, 4, inward=False)
    body = shapes.receiver(vertices, triangles)
    where, found = horizon_of(body, body.vertices, triangles)
    out, counts = traced(where, body.vertices, triangles, horizon=found)
    np.testing.assert_allclose(out, sh.open_transfer(where.normals, 3), atol=1e-6)
    assert counts[transfer.CAST] == 0


def test_points_that_see_nothing_stop_early():
    room, triangles = shapes.box(2.0, 8)
    inside = points.distinct_points(shapes.receiver(room, triangles))
    out, counts = traced(inside, room, triangles, pilot=4)
    assert not out.any()
    assert counts[transfer.CAST] == len(inside.origins) * 64
    assert counts[transfer.SEES_NOTHING] == len(inside.origins) * 192


def test_points_that_see_something_trace_everything():
    receiver, vertices, triangles = shapes.knot_scene(100, 12)
    where = points.distinct_points(receiver)
    plain, _ = traced(where, vertices, triangles)
    staged, _ = traced(where, vertices, triangles, pilot=4)
    sees = staged.any(axis=1)
    np.testing.assert_array_equal(staged[sees], plain[sees])
    assert transfer.relative_rms(staged, plain) < 0.01


def test_kept_visibility_needs_no_ray():
    receiver, vertices, triangles = shapes.knot_scene(100, 12)
    where = points.distinct_points(receiver)
    bits = np.zeros((len(where.origins), 13), np.uint8)
    first, _ = traced(where, vertices, triangles, count=100, bits=bits)
    again, counts = traced(
        where, *shapes.box(), count=100, bits=bits, known=np.ones(len(bits), bool)
    )
    np.testing.assert_array_equal(again, first)
    assert counts[transfer.CAST] == 0


@pytest.mark.parametrize("pilot", [0, 4])
def test_points_among_others_that_are_known_are_traced_as_they_would_be(pilot):
    receiver, vertices, triangles = shapes.knot_scene(100, 12)
    where = points.distinct_points(receiver)
    bits = np.zeros((len(where.origins), 13), np.uint8)
    first, _ = traced(where, vertices, triangles, count=100, bits=bits, pilot=pilot)
    known = np.random.default_rng(0).random(len(bits)) < 0.7
    again = np.where(known[:, None], bits, np.uint8(255))
    found, counts = traced(
        where, vertices, triangles, count=100, bits=again, known=known, pilot=pilot
    )
    np.testing.assert_array_equal(found, first)
    np.testing.assert_array_equal(again, bits)
    assert counts[transfer.KNOWN] == 100 * known.sum()


@pytest.mark.parametrize("count", [100, 256])
def test_same_bits_for_any_batch_size(monkeypatch, count):
    receiver, vertices, triangles = open_field()
    where, found = horizon_of(receiver, vertices, triangles)
    results = []
    for size in (1, 5000, 1 << 20):
        monkeypatch.setattr(transfer, "BATCH_RAYS", size)
        results.append(traced(where, vertices, triangles, count, horizon=found)[0])
    np.testing.assert_array_equal(results[0], results[1])
    np.testing.assert_array_equal(results[0], results[2])


def test_only_what_is_flat_is_looked_at_in_a_mesh_of_both():
    """A ball on a floor, in one mesh: a look from the ball would be dear and tell little."""
    ball, faces, _ = shapes.sphere(16, 32)
    floor = shapes.grid([-5, -5, -1.5], [10, 0, 0], [0, 10, 0], 40)
    vertices, triangles = shapes.join(floor, (ball, faces))
    where, found = horizon_of(shapes.receiver(vertices, triangles), vertices, triangles)
    in_floor = where.origins[:, 2] < -1.4
    of_ball = np.flatnonzero(~in_floor)[:64].reshape(4, 16)
    of_floor = np.flatnonzero(in_floor)[:64].reshape(4, 16)
    assert (found.open_shares(where.origins[of_ball], where.normals[of_ball]) == 0).all()
    assert (found.open_shares(where.origins[of_floor], where.normals[of_floor]) > 0.5).any()


def test_corners_in_the_open_are_known_side_by_side():
    vertices, triangles = shapes.box(2.0, 1, inward=False)
    corners = points.distinct_points(shapes.receiver(vertices, triangles))
    other = shapes.grid([9, -1, -1], [0, 2, 0], [0, 0, 2], 1)
    found = horizon.Horizon(clusters_of(*other))
    order = np.argsort(corners.origins @ np.float32([1, 2, 4]))[:12].reshape(1, 12)
    shares = found.open_shares(corners.origins[order], corners.normals[order], 4)
    alone = found.open_shares(corners.origins[order[0], None], corners.normals[order[0], None])
    expected = alone.min(axis=2).reshape(4, 3).min(axis=1)
    np.testing.assert_allclose(shares[0].min(axis=1), expected, atol=1e-15)
