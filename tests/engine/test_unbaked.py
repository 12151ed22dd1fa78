"""Places on what is not baked, without rays."""

from collections import Counter
from dataclasses import replace

import numpy as np
import shapes
from prt_baker.addon.prt.bounces.entries import Entries
from prt_baker.addon.prt.bounces.unbaked import Unbaked
from prt_baker.addon.prt.surface.points import distinct_points
from prt_baker.addon.prt.tracing import rays
from test_bounces import job_of


def traced(light):
    """A trace that finds this first coefficient everywhere."""

    def trace(places, _rays, _look):
        yield 0
        return np.full((len(places.origins), 9), light, np.float32), None, Counter()

    return trace


def unseen(back, light):
    """How many places the cells of a closed box, or their backs, are given, and of how many the
    rays count for nothing, where they see so much ``light``."""
    floor = shapes.grid([-1, -1, -1], [2, 0, 0], [0, 2, 0], 4)
    crate = shapes.box(1.0, 6, inward=False)
    vertices, triangles = shapes.join(floor, crate)
    job = job_of((shapes.receiver(*floor),), vertices, triangles, 0.8)
    entries = Entries.of(job, [distinct_points(job.receivers[0])])
    occlusion = rays.occlusion(job.occluder_vertices, job.occluder_triangles)
    work = Unbaked(entries, job.occluder_vertices, job.occluder_triangles, occlusion, 25)
    used = np.flatnonzero(entries.points < 0) + back * entries.count
    for _ in work.add(used, traced(light), 64, last=False):
        pass
    return work.places, int(work.unseen[0].sum())


def test_what_a_ray_that_slipped_into_a_thing_meets_is_not_followed():
    places, without = unseen(back=True, light=0.0)
    assert without == places > 0


def test_light_inside_of_a_thing_is_followed():
    """A room whose walls face outward, with a window."""
    assert unseen(back=True, light=0.1)[1] == 0


def test_the_outside_of_things_in_the_dark_is_followed():
    assert unseen(back=False, light=0.0)[1] == 0


def test_triangles_of_a_receiver_are_found_in_any_order():
    """As one occluder as it is, or turned and shuffled among others'."""
    floor = shapes.grid([-1, -1, -1], [2, 0, 0], [0, 2, 0], 4)
    crate = shapes.box(1.0, 6, inward=False)
    body = shapes.receiver(*crate)
    points = distinct_points(body)
    vertices, triangles = shapes.join(floor, crate)
    alone = job_of((body,), *crate[:2], 0.8)
    rows = Entries.of(alone, [points]).points.reshape(-1, 3)
    assert (rows >= 0).all()
    job = job_of((body,), vertices, triangles, 0.8)
    starts = np.array([0, len(floor[1]), len(triangles)])
    whole = Entries.of(replace(job, occluder_starts=starts), [points])
    order = np.random.default_rng(0).permutation(len(triangles))
    turned = np.roll(np.asarray(triangles)[order], 1, axis=1)
    shuffled = Entries.of(replace(job, occluder_triangles=turned), [points])
    for entries, its in ((whole, np.arange(len(triangles))), (shuffled, order)):
        first = entries.first[np.argsort(its)][len(floor[1]) :]
        found = entries.points[first[:, None] + np.arange(3)]
        np.testing.assert_array_equal(found if its is not order else np.roll(found, -1, 1), rows)
        assert (entries.levels > 0).sum() == len(floor[1])


def test_a_cell_that_shows_beside_what_hides_its_patch_is_lit():
    """A cupboard stands before a wall, whose cells end a little beside it."""
    floor = shapes.grid([-3, -3, -1], [6, 0, 0], [0, 6, 0], 4)
    wall = shapes.grid([-1, 1, -1], [2, 0, 0], [0, 0, 2], 1)
    cupboard = shapes.box(1.0, 1, inward=False)
    cupboard = cupboard[0] * [1.0, 0.4, 1.8] + [-0.47, 0.8, 0], cupboard[1]
    vertices, triangles = shapes.join(floor, wall, cupboard)
    job = job_of((shapes.receiver(*floor),), vertices, triangles, 0.8)
    entries = Entries.of(job, [distinct_points(job.receivers[0])])
    occlusion = rays.occlusion(job.occluder_vertices, job.occluder_triangles)
    work = Unbaked(entries, job.occluder_vertices, job.occluder_triangles, occlusion, 25)
    of_wall = np.arange(entries.first[len(floor[1])], entries.first[len(floor[1]) + 2])
    places = []

    def trace(its, _rays, _look):
        places.append(its)
        return (yield from traced(1.0)(its, _rays, _look))

    for _ in work.add(of_wall, trace, 64, last=False):
        pass
    its, barycentric = entries.places(of_wall)
    triangles = job.occluder_vertices[job.occluder_triangles[its]]
    corners = np.stack([entries.places(of_wall, k)[1] for k in range(3)])
    at = np.einsum("kec,ecx->kex", corners, triangles)
    shows = (np.abs(at[..., 0] + 0.47) > 0.5) | (np.abs(at[..., 2]) > 0.9)
    middle = np.einsum(
        "ec,ecx->ex", barycentric, job.occluder_vertices[job.occluder_triangles[its]]
    )
    beside = shows.any(axis=0) & (np.abs(middle[:, 0] + 0.47) < 0.5) & (np.abs(middle[:, 2]) < 0.9)
    assert beside.sum() > 4
    origins = places[0].origins[work.nodes[of_wall[beside]] - 25]
    assert ((np.abs(origins[:, 0] + 0.47) > 0.5) | (np.abs(origins[:, 2]) > 0.9)).all()
