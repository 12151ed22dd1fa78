"""Transfer against closed forms, and the laws that any bake keeps."""

from contextlib import closing

import numpy as np
import pytest
import shapes
from prt_baker.addon.prt import sh
from prt_baker.addon.prt.job import Settings
from prt_baker.addon.prt.surface import points
from prt_baker.addon.prt.tracing import rays, tolerance, transfer

UP = [0.0, 0.0, 1.0]


def at(origins, normals):
    origins, normals = np.atleast_2d(origins), np.atleast_2d(normals)
    empty = np.empty(0, np.int32)
    return points.Points(origins.astype(np.float32), normals.astype(np.float32), empty)


def trace(where, sky, order=3, count=256, **others):
    out = np.empty((len(where.origins), order**2), np.float32)
    settings = Settings(order, count, **{"threads": 1, **others})
    for _ in transfer.trace_all(where, sky, settings, out):
        pass
    return out


def random_normals(count, seed=0):
    normals = np.random.default_rng(seed).normal(size=(count, 3))
    return normals / np.linalg.norm(normals, axis=1, keepdims=True)


def integral(visible, order, count=400):
    """1/pi integral V cos Y by Gauss-Legendre over the upper half, ``visible(theta, phi)``."""
    nodes, weights = np.polynomial.legendre.leggauss(count)
    cosine, phi = 0.5 * (nodes + 1), np.pi * (nodes + 1)
    c, p = np.meshgrid(cosine, phi, indexing="ij")
    sine = np.sqrt(1 - c * c)
    directions = np.stack([sine * np.cos(p), sine * np.sin(p), c], -1)
    area = np.outer(0.5 * weights, weights)  # d(cos theta) d(phi) over pi
    return np.einsum("ij,ijk->k", area * c * visible(np.arccos(c), p), sh.basis(directions, order))


class Above:
    """Everything within ``angle`` of the zenith is covered."""

    lets_slip = False

    def __init__(self, angle):
        self.z = np.cos(angle)

    def sky_mask(self, origins, directions):
        return np.where(directions[:, 2] > self.z, rays.BLOCKED, rays.CLEAR).astype(np.int32)


@pytest.mark.parametrize("order", [2, 3, 4, 5])
def test_open_surface_is_the_clamped_cosine(order):
    normals = random_normals(50)
    result = trace(at(np.zeros((50, 3)), normals), rays.Sky(), order, 64)
    np.testing.assert_allclose(result, sh.open_transfer(normals, order), atol=1e-6)


def test_nothing_is_seen_under_a_lid():
    assert not trace(at(np.zeros((5, 3)), random_normals(5)), rays.Lid()).any()


def test_white_sky_makes_an_open_white_surface_white():
    white = sh.basis(UP, 3)[0] * 4 * np.pi  # the projection of the constant 1 is L0 alone
    result = trace(at(np.zeros((200, 3)), random_normals(200)), rays.Sky())
    np.testing.assert_allclose(result[:, 0] * white, 1, atol=1e-5)


def test_foot_of_an_infinite_wall():
    wall = shapes.grid([-1e4, 0, -1e4], [2e4, 0, 0], [0, 0, 2e4], 1)
    where = at(np.tile([0.0, -1e-3, 0.0], (64, 1)), np.tile(UP, (64, 1)))
    result = trace(where, rays.Triangles(*wall), count=4096)
    expected = integral(lambda theta, phi: (phi > np.pi).astype(float), 3)
    assert np.abs(result - expected).max() < 5e-4


def test_under_a_disc():
    """A disc of radius 1 at height 1 covers the cap of 45 degrees."""
    angle = np.linspace(0, 2 * np.pi, 2049)[:-1]
    rim = np.stack([np.cos(angle), np.sin(angle), np.ones_like(angle)], 1)
    fan = np.stack([np.zeros(2048), 1 + np.arange(2048), 1 + (np.arange(2048) + 1) % 2048], 1)
    disc = rays.Triangles(np.concatenate([[[0, 0, 1.0]], rim]), fan.astype(np.int32))
    result = trace(at(np.zeros((64, 3)), np.tile(UP, (64, 1))), disc, count=4096)
    bands = np.sqrt(np.array([1, 3, 5]) / (4 * np.pi))
    s = 0.5  # sin² of 45 degrees; closed forms of 2 integral_0^cos45 c P_l(c) dc
    c = np.sqrt(0.5)
    zonal = bands * np.array([1 - s, 2 * c**3 / 3, 3 * c**4 / 4 - c**2 / 2])
    expected = np.zeros(9)
    expected[[0, 2, 6]] = zonal
    assert np.abs(result - expected).max() < 5e-4


@pytest.mark.parametrize("angle", [0.3, 0.8, 1.2])
def test_error_falls_faster_than_monte_carlo(angle):
    expected = integral(lambda theta, phi: (theta > angle).astype(float), 3, 1000)
    where = at(np.zeros((32, 3)), np.tile(UP, (32, 1)))
    errors = [transfer.relative_rms(trace(where, Above(angle), count=n), [expected] * 32)
              for n in (64, 1024)]  # fmt: skip
    assert errors[1] < errors[0] / 16**0.6


def test_turning_the_scene_turns_the_transfer():
    rng = np.random.default_rng(3)
    turn, _ = np.linalg.qr(rng.normal(size=(3, 3)))
    turn *= np.linalg.det(turn)
    vertices, triangles = shapes.grid([-1, -1, 0.5], [2, 0, 0], [0, 2, 0], 4)
    before = trace(at([0, 0, 0], UP), rays.Triangles(vertices, triangles), count=8192)
    turned = rays.Triangles(vertices @ turn.T, triangles)
    after = trace(at([0, 0, 0], turn @ UP), turned, count=8192)
    expected = sh.rotate(before[0], turn)
    np.testing.assert_allclose(after[0], expected, atol=1e-3)


def test_same_bits_for_any_number_of_threads():
    receiver, vertices, triangles = shapes.knot_scene()
    where = points.distinct_points(receiver)
    sky = rays.occlusion(vertices, triangles)
    one, two = (trace(where, sky, count=16, threads=n) for n in (1, 2))
    assert (one == two).all()


@pytest.mark.parametrize(("count", "each"), [(1, 16), (5000, 64), (30000, 256)])
def test_parts_hold_every_point_once_and_are_no_larger_towards_the_end(count, each):
    where = at(np.zeros((count, 3)), np.tile(UP, (count, 1)))
    settings = Settings(rays=each)
    tracer = transfer.Tracer(where, rays.Sky(), settings, transfer.Shortcuts(), None)
    (whole,) = tracer.open_rays.pieces()
    groups = [part.groups for part in tracer.parts(tracer.open_rays.find(whole))]
    sizes = [len(part) for part in groups]
    assert np.array_equal(np.concatenate(groups), np.arange(-(-count // transfer.GROUP)))
    assert sizes == sorted(sizes, reverse=True)
    assert max(sizes) * transfer.GROUP * each <= transfer.PART_RAYS[1]


def test_closing_stops_the_rays():
    where = at(np.zeros((100_000, 3)), np.tile(UP, (100_000, 1)))
    out = np.full((100_000, 9), np.nan, np.float32)
    with closing(transfer.trace_all(where, rays.Sky(), Settings(), out)) as steps:
        next(steps)
    assert np.isnan(out).any()


@pytest.mark.parametrize("count", [64, 256])
def test_estimated_error_is_the_true_one(count):
    """Within the 0.85 .. 1.15 that a pooled estimate over a whole mesh can be held to."""
    receiver, vertices, triangles = shapes.knot_scene()
    where = points.distinct_points(receiver)
    some = at(where.origins[::29], where.normals[::29])
    sky = rays.occlusion(vertices, triangles)
    result, reference = trace(some, sky, count=count), trace(some, sky, count=16384, seed=9)
    estimate, _ = tolerance.estimate_error(some, sky, Settings(rays=count), result)
    assert 0.85 < estimate / transfer.relative_rms(result, reference) < 1.15
