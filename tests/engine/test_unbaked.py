"""Places on what is not baked, without rays."""

from collections import Counter

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
