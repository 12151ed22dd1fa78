"""Rays that slip between triangles show nowhere."""

import numpy as np
import pytest
import shapes
from prt_baker.addon.prt.bounces.entries import Entries
from prt_baker.addon.prt.bounces.hits import Meeting
from prt_baker.addon.prt.job import Settings
from prt_baker.addon.prt.steps import value_of
from prt_baker.addon.prt.surface.points import Points, distinct_points
from prt_baker.addon.prt.tracing import confirm, rays, transfer

UP = (0.0, 0.0, 1.0)
OUTSIDE = 7  # a triangle that only a ray which slipped can meet


class Leaky:
    """``inner``, through which about every ``period``-th direction slips, counted as ``slipped``;
    of first things met every ``period``-th."""

    lets_slip = True

    def __init__(self, inner, period):
        self.inner, self.period, self.asked_again = inner, period, 0
        self.asked, self.slipped = 0, 0

    def sky_mask(self, origins, directions):
        mask = self.inner.sky_mask(origins, directions)
        bits = np.ascontiguousarray(directions, np.float32).view(np.uint32)
        slips = (bits.sum(axis=1, dtype=np.uint64) * 2654435761 >> 20) % self.period == 0
        mask[slips] = rays.CLEAR
        self.asked += len(mask)
        self.slipped += slips.sum()
        return mask

    def first_met(self, origins, directions):
        met = self.inner.first_met(origins, directions)
        met.triangles[:: self.period] = OUTSIDE
        return met

    def watertight(self):
        self.asked_again += 1
        return self.inner


def transfer_of(occlusion, count, points=16):
    where = Points(np.zeros((points, 3), np.float32), np.tile(np.float32(UP), (points, 1)), None)
    out = np.empty((points, 9), np.float32)
    steps = transfer.trace_all(where, occlusion, Settings(rays=count, threads=1), out)
    return out, value_of(steps)


def test_a_point_in_the_dark_stays_dark():
    leaky = Leaky(rays.Lid(), 400)
    found, counts = transfer_of(leaky, 256, points=64)
    assert 20 < leaky.slipped < 80
    assert not found.any()
    assert counts[transfer.CAST] == leaky.asked > 64 * 256


def test_in_the_open_nothing_is_asked_again():
    leaky = Leaky(rays.Sky(), 100)
    found, counts = transfer_of(leaky, 256)
    assert leaky.asked == 16 * 256
    assert found.any()
    assert counts[transfer.CAST] == 16 * 256


def test_where_nothing_slips_nothing_is_asked_again():
    visible = np.zeros((4, 64), np.float32)
    visible[:, 0] = 1
    assert not confirm.doubtful(visible, rays.Lid()).any()
    assert confirm.doubtful(visible, Leaky(rays.Lid(), 1)).all()


def test_what_is_seen_through_a_slit_is_kept():
    """A ray that reaches the sky truly is confirmed."""
    leaky = Leaky(rays.Sky(), 1)
    origins, directions = np.zeros((5, 3), np.float32), np.eye(3, dtype=np.float32)[[0, 1, 2, 0, 1]]
    np.testing.assert_array_equal(confirm.confirmed(leaky, origins, directions), np.ones(5))


@pytest.mark.parametrize("expected", [0, 1e9])
def test_both_modes_see_the_same(expected):
    receiver, vertices, triangles = shapes.knot_scene(120, 12)
    where = distinct_points(receiver)
    occlusion = rays.occlusion(vertices, triangles, expected)
    assert occlusion.lets_slip == (expected > 0)
    assert not occlusion.watertight().lets_slip
    out, reference = np.empty((2, len(where.origins), 9), np.float32)
    for _ in transfer.trace_all(where, occlusion, Settings(rays=64), out):
        pass
    for _ in transfer.trace_all(where, occlusion.watertight(), Settings(rays=64), reference):
        pass
    different = np.abs(out - reference).max(axis=1) > 1e-6
    assert different.mean() < 0.002  # a ray in some millions, at most a point or two


class Walls(rays.Sky):
    """Triangle 0 beside the sky, which a ``share`` of the rays of every place reaches."""

    def __init__(self, share):
        self.share = share

    def first_met(self, origins, directions):
        met = super().first_met(origins, directions)
        met.triangles[np.arange(len(directions)) % 64 >= self.share * 64] = 0
        return met


def met(walls, period, places=32):
    """The triangles (P, 64) that are met through what lets every ``period``-th ray slip."""
    leaky = Leaky(walls, period)
    meeting = Meeting(lambda: leaky, Entries(*np.zeros((3, 8), np.int32), 8), 0)
    towards = np.zeros((64 * places, 3), np.float32)
    return meeting._met(0, 64, towards, towards).triangles.reshape(-1, 64), leaky.asked_again


def test_nothing_from_outside_is_met_in_the_dark():
    for share in (0, 1 / 64, 1 / 32):
        found, asked = met(Walls(share), 50)
        assert asked == 2, "after the first places all are cast in the robust mode"
        assert not (found == OUTSIDE).any()
        np.testing.assert_array_equal((found < 0).mean(axis=1), share)


def test_in_the_light_what_slips_is_let_be():
    found, asked = met(Walls(0.5), 50)
    assert asked == 0
    assert (found == OUTSIDE).sum() >= 32 * 64 // 50


def test_a_dark_place_among_others_is_cast_again():
    class Mixed(Walls):
        def first_met(self, origins, directions):
            whole = super().first_met(origins, directions)
            whole.triangles[origins[:, 0] > 0] = 0
            return whole

    walls = Leaky(Mixed(0.5), 50)
    meeting = Meeting(lambda: walls, Entries(*np.zeros((3, 8), np.int32), 8), 0)
    origins = np.zeros((64 * 32, 3), np.float32)
    origins[64 * 20 : 64 * 21] = 1
    found = meeting._met(0, 64, origins, origins).triangles.reshape(-1, 64)
    assert walls.asked_again == 1
    assert (found[20] == 0).all()
    assert (found[19] == OUTSIDE).any()
