"""Which points are traced, and from where."""

import numpy as np
import pytest
import shapes
from prt_baker.addon.prt import sh
from prt_baker.addon.prt.surface import points
from prt_baker.addon.prt.tracing import rays
from test_transfer import trace


def test_flat_grid_traces_each_vertex_once():
    vertices, triangles = shapes.grid([0, 0, 0], [1, 0, 0], [0, 1, 0], 10)
    where = points.distinct_points(shapes.receiver(vertices, triangles))
    assert len(where.origins) == len(vertices)
    assert len(where.element_points) == triangles.size


def test_box_traces_each_vertex_once_for_each_side():
    vertices, triangles = shapes.box(count=4)
    where = points.distinct_points(shapes.receiver(vertices, triangles))
    assert len(where.origins) == 6 * 25


def test_coincident_vertices_with_one_normal_are_one_point():
    vertices, triangles = shapes.grid([0, 0, 0], [1, 0, 0], [0, 1, 0], 4)
    split = vertices[triangles.reshape(-1)]
    separate = np.arange(len(split)).reshape(-1, 3)
    where = points.distinct_points(shapes.receiver(split, separate))
    assert len(where.origins) == len(vertices)


def test_every_element_shows_a_point_at_its_place():
    vertices, triangles, normals = shapes.sphere(16, 32)
    receiver = shapes.receiver(vertices, triangles, normals)
    where = points.distinct_points(receiver)
    near = where.origins[where.element_points]
    assert np.abs(near - vertices).max() < 0.01
    np.testing.assert_allclose(where.normals[where.element_points], normals, atol=1e-6)


def test_loose_vertices_have_no_point():
    vertices, triangles = shapes.grid([0, 0, 0], [1, 0, 0], [0, 1, 0], 2)
    vertices = np.concatenate([vertices, [[5.0, 5, 5]]])
    receiver = shapes.receiver(vertices, triangles, np.tile([0.0, 0, 1], (len(vertices), 1)))
    assert points.distinct_points(receiver).element_points[-1] == -1


def test_faces_without_area_have_no_point():
    vertices = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [2, 0, 0]])
    triangles = np.array([[0, 1, 2], [0, 1, 3]])
    where = points.distinct_points(shapes.receiver(vertices, triangles))
    assert (where.element_points[3:] == -1).all()
    assert (where.element_points[:3] >= 0).all()


def test_missing_normals_are_replaced_by_the_faces():
    vertices, triangles = shapes.grid([0, 0, 0], [1, 0, 0], [0, 1, 0], 2)
    receiver = shapes.receiver(vertices, triangles, np.zeros((len(vertices), 3)))
    np.testing.assert_allclose(points.distinct_points(receiver).normals[:, 2], 1)


@pytest.mark.parametrize("place", [(0, 0, 0), (100, -50, 30)])
@pytest.mark.parametrize("size", [1e-3, 2.0, 1e3])
@pytest.mark.parametrize("fast", [False, True])
def test_nothing_leaks_into_a_closed_box(size, place, fast):
    """Every vertex of a box lies on edges and in inner corners; none may see the sky."""
    vertices, triangles = shapes.box(size, 8)
    vertices = vertices + np.array(place) * size
    receiver = shapes.receiver(vertices, triangles)
    where = points.distinct_points(receiver)
    sky = rays.Triangles(receiver.vertices, triangles, fast)
    assert np.abs(trace(where, sky, count=256)).max() == 0


def test_inner_corners_see_their_open_part():
    """In a box without its lid, the lower corners' floor sees the sky as the limit there does."""
    vertices, triangles = shapes.box(2.0, 8)
    top = (vertices[triangles][:, :, 2] > 0.999).all(axis=1)
    receiver = shapes.receiver(vertices, triangles[~top])
    where = points.distinct_points(receiver)
    sky = rays.occlusion(receiver.vertices, triangles[~top])
    result = trace(where, sky, count=4096)
    corners = np.abs(np.abs(where.origins[:, :2]) - 1).max(axis=1) < 0.01
    floor = corners & (where.normals[:, 2] > 0.5)
    assert floor.sum() == 4
    visible = result[floor, 0] / sh.basis([0, 0, 1.0], 1)[0]
    a = 1.0  # the lid is a 2 x 2 square 2 above its corner: form factor, Howell C-11
    factor = 2 * a / np.sqrt(1 + a * a) * np.arctan(a / np.sqrt(1 + a * a)) / (2 * np.pi)
    np.testing.assert_allclose(visible, factor, rtol=0.03)


def test_a_smooth_convex_mesh_does_not_shadow_itself():
    """However coarse: its points lie on or above the tangent planes."""
    vertices, triangles, normals = shapes.sphere(5, 8)
    receiver = shapes.receiver(vertices, triangles, normals)
    where = points.distinct_points(receiver)
    sky = rays.occlusion(receiver.vertices, triangles)
    expected = sh.open_transfer(where.normals, 3)
    np.testing.assert_allclose(trace(where, sky), expected, atol=1e-5)


def test_a_point_lies_in_the_triangle_with_the_widest_angle():
    vertices = np.array([[0.0, 0, 0], [4, 0, 0], [4, 1, 0], [-4, 3, 0]])
    receiver = shapes.receiver(vertices, [[0, 1, 2], [0, 2, 3]], np.tile([0.0, 0, 1], (4, 1)))
    where = points.distinct_points(receiver)
    x, y, _ = where.origins[where.element_points[0]]
    assert y > x / 4  # above the edge from vertex 0 to vertex 2, in the second triangle


def test_a_surface_tells_of_some_triangles_what_it_does_of_all(monkeypatch):
    monkeypatch.setattr(points, "PIECE", 7)
    vertices, triangles, _ = shapes.sphere(12, 24)
    triangles = np.concatenate([triangles, [[0, 5, 5]]])  # without an area
    surface = points.Surface.of(shapes.receiver(vertices, triangles))
    np.testing.assert_array_equal(surface.corners, vertices.astype(np.float32)[triangles])
    a, b, c = surface.corners.transpose(1, 0, 2)
    cross = np.cross(b - a, c - a)
    np.testing.assert_allclose(surface.normals * 2 * surface.areas[:, None], cross, atol=1e-12)
    np.testing.assert_allclose(
        np.linalg.norm(surface.normals, axis=1), surface.solid, rtol=1e-12, atol=0
    )
    assert not surface.solid[-1]
    some = np.array([40, 3, len(triangles) - 1, 3])
    np.testing.assert_array_equal(surface.corners_of(some), surface.corners[some])
    np.testing.assert_array_equal(points.face_normals(surface.corners[some]), surface.normals[some])
    solid = surface.only(surface.solid)
    np.testing.assert_array_equal(solid.corners, surface.corners[:-1])
    np.testing.assert_array_equal(solid.areas, surface.areas[:-1])


@pytest.mark.parametrize("domain", ["POINT", "CORNER"])
def test_pieces_change_nothing(domain, monkeypatch):
    vertices, triangles, normals = shapes.sphere(24, 48)
    receiver = shapes.receiver(vertices, triangles, normals if domain == "POINT" else None)
    whole = points.distinct_points(receiver)
    monkeypatch.setattr(points, "PIECE", 7)
    parts = points.distinct_points(receiver)
    for name in ("origins", "normals", "element_points"):
        np.testing.assert_array_equal(getattr(whole, name), getattr(parts, name))


def test_what_differs_in_two_signs_is_not_the_same():
    """A number's sign is its highest bit: what is lost first where keys are mixed."""
    corner = np.array([[1.0, 1, 1], [2, 1, 1], [1, 2, 1]])
    signs = np.array(np.meshgrid(*[[1, -1]] * 3)).reshape(3, -1).T
    vertices = (corner[None] * signs[:, None]).reshape(-1, 3)
    vertices = np.concatenate([vertices, vertices])  # every one twice
    where = points.distinct_points(
        shapes.receiver(vertices, np.arange(48).reshape(-1, 3), vertices / 2)
    )
    assert len(where.origins) == 24
    np.testing.assert_array_equal(where.element_points[:24], where.element_points[24:])


def test_zero_has_no_sign():
    vertices = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [-0.0, 0, -0.0], [1, 0, 0], [0, 1, 0]])
    receiver = shapes.receiver(vertices, [[0, 1, 2], [3, 4, 5]], np.tile([0.0, 0, 1], (6, 1)))
    assert len(points.distinct_points(receiver).origins) == 3


def test_morton_order_keeps_neighbours_together():
    grid = np.stack(np.meshgrid(*[np.arange(16.0)] * 3), -1).reshape(-1, 3)
    shuffled = grid[np.random.default_rng(0).permutation(len(grid))]
    steps = np.diff(shuffled[points.morton_order(shuffled)], axis=0)
    assert np.abs(steps).sum(axis=1).mean() < 3


@pytest.mark.parametrize("kind", [np.float32, np.float64])
def test_one_place_alone_has_an_order(kind):
    assert points.morton_order(np.array([[1, 2, 3]], kind)).tolist() == [0]
    assert points.morton_order(np.array([[1, 2, 3]] * 3, kind)).tolist() == [0, 1, 2]
