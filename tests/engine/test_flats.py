"""Flat grids that rays meet as a few large triangles."""

import numpy as np
import pytest
import shapes
from prt_baker.addon.prt.tracing import flats, rays
from prt_baker.addon.prt.tracing.flats import Parts, fewer

COUNT = 20  # squares along a side: 800 triangles
CIRCLE = np.linspace(0, 2 * np.pi, 12, endpoint=False)


def floor(origin=(-1, -1, 0), along=(2, 0, 0), across=(0, 2, 0)):
    return shapes.grid(origin, along, across, COUNT)


def fewer_of(*parts):
    """The corners of the triangles that stand for ``parts``, (F, 3, 3), and of all of these."""
    vertices, triangles = shapes.join(*parts)
    starts = np.cumsum([0] + [len(part[1]) for part in parts])
    before = Parts.of(vertices, triangles, starts)
    after = fewer(before)
    assert len(after.starts) == len(starts)
    assert after.starts[-1] == len(after.triangles)
    return (p.vertices[p.triangles] for p in (after, before))


def area_vectors(corners):
    a, b, c = corners.astype(np.float64).transpose(1, 0, 2)
    return 0.5 * np.cross(b - a, c - a)


@pytest.mark.parametrize("axis", range(3))
@pytest.mark.parametrize("flipped", [False, True])
def test_a_rectangle_is_two_triangles_that_face_as_it_did(axis, flipped):
    vertices, triangles = floor([-1, -1, 0.3], [2, 0.5, 0], [-0.5, 2, 0])
    triangles = triangles[:, ::-1] if flipped else triangles
    found, all_of_them = fewer_of((np.roll(vertices, axis, axis=1), triangles))
    assert len(found) == 2
    before, after = area_vectors(all_of_them), area_vectors(found)
    np.testing.assert_allclose(after.sum(axis=0), before.sum(axis=0), atol=1e-6)
    assert (after[:, axis - 1] * before[0, axis - 1] > 0).all()


def test_a_disc_is_its_polygon():
    rings = np.linspace(0, 1, 40)[1:, None, None] * np.stack([np.cos(CIRCLE), np.sin(CIRCLE)], 1)
    vertices, triangles = shapes.wrapped(np.pad(rings, ((0, 0), (0, 0), (0, 1))), 39, 12)
    outward = (triangles < 38 * 12).any(axis=1) & ~(
        (triangles < 12).any(axis=1) & (triangles >= 38 * 12).any(axis=1)
    )
    middle = np.stack([np.full(12, len(vertices)), np.arange(12), (np.arange(12) + 1) % 12], 1)
    own = np.concatenate([triangles[outward], middle])
    up = area_vectors(np.concatenate([vertices, np.zeros((1, 3))])[own])[:, 2] > 0
    own[~up] = own[~up, ::-1]
    found, _ = fewer_of((np.concatenate([vertices, np.zeros((1, 3))]), own))
    assert len(found) == 10


def wavy():
    vertices, triangles = floor()
    vertices[len(vertices) // 2, 2] = 1e-6
    return vertices, triangles


def holed():
    vertices, triangles = floor()
    return vertices, np.delete(triangles, 411, axis=0)


def doubled_beside_a_hole():
    vertices, triangles = floor()
    triangles[411] = triangles[399]  # as much area as before
    return vertices, triangles


def bent_in():
    vertices, triangles = floor()
    return vertices, triangles[~(vertices[triangles][..., :2] >= 0).all(axis=(1, 2))]


def torn():
    vertices, triangles = floor()
    away = triangles[400:] + len(vertices)
    return np.concatenate([vertices, vertices]), np.concatenate([triangles[:400], away])


def of_two_sides():
    vertices, triangles = floor()
    triangles[7] = triangles[7, ::-1]
    return vertices, triangles


@pytest.mark.parametrize(
    "mesh",
    [wavy, holed, doubled_beside_a_hole, bent_in, torn, of_two_sides],
    ids=lambda f: f.__name__,
)
def test_what_is_no_whole_convex_polygon_stays(mesh):
    after, before = fewer_of(mesh())
    np.testing.assert_array_equal(after, before)


def test_pieces_tell_the_same(monkeypatch):
    monkeypatch.setattr(flats, "PIECE", 7)
    found, _ = fewer_of(floor())
    assert len(found) == 2
    for mesh in (torn, doubled_beside_a_hole):
        after, before = fewer_of(mesh())
        np.testing.assert_array_equal(after, before)


def test_small_grids_stay():
    after, before = fewer_of(shapes.grid([0, 0, 0], [1, 0, 0], [0, 1, 0], 10))
    np.testing.assert_array_equal(after, before)


def test_a_closed_box_stays_whole_where_its_sides_meet():
    after, before = fewer_of(shapes.box(count=COUNT))
    np.testing.assert_array_equal(after, before)


def test_a_side_that_another_triangle_hangs_on_stays():
    vertices, triangles = floor()
    hung = (
        np.concatenate([vertices, [[0, 0, 1]]]),
        np.concatenate([triangles, [[200, 201, len(vertices)]]]),
    )
    after, before = fewer_of(hung)
    np.testing.assert_array_equal(after, before)


def test_a_wall_that_ends_at_the_floor_s_sides_leaves_it_large():
    wall = shapes.grid([-1, 0.5, 0], [2, 0, 0], [0, 0, 1], COUNT)
    found, _ = fewer_of(floor(), wall)
    assert len(found) == 2 + 2 * COUNT**2  # the wall's foot has the floor's vertices along it


def test_tiles_in_one_plane_are_told_apart_by_part():
    found, _ = fewer_of(floor(), floor([1.5, -1, 0]))
    assert len(found) == 4


def test_rays_find_the_same():
    shape, triangles, _ = shapes.sphere(16, 32, 0.5)
    parts = floor([-3, -3, -0.6], [6, 0, 0], [0, 6, 0]), (shape, triangles)
    vertices, all_of_them = shapes.join(*parts)
    random = np.random.default_rng(3)
    origins = random.uniform(-3, 3, (100_000, 3)).astype(np.float32)
    directions = random.normal(size=origins.shape).astype(np.float32)
    starts = [0, len(parts[0][1]), len(all_of_them)]
    few = fewer(Parts.of(vertices, all_of_them, starts))
    assert few.starts.tolist() == [0, 2, 2 + len(triangles)]
    whole = rays.occlusion(vertices, all_of_them)
    large = rays.occlusion(few.vertices, few.triangles)
    found, expected = (g.sky_mask(origins, directions) for g in (large, whole))
    assert 0.2 < (found == rays.BLOCKED).mean() < 0.9
    np.testing.assert_array_equal(found, expected)
    backs = [g.meets_back(origins, directions) for g in (large, whole)]
    np.testing.assert_array_equal(*backs)
