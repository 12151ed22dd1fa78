"""A convex body is told from one that only looks like it."""

import numpy as np
import pytest
import shapes
from prt_baker.addon.prt.surface.convex import is_convex
from scipy.spatial import ConvexHull


def ball(bump=0.0):
    """The hull of places on a sphere, smooth; one vertex pushed in by ``bump``."""
    places = np.random.default_rng(0).normal(size=(300, 3))
    places /= np.linalg.norm(places, axis=1, keepdims=True)
    faces = ConvexHull(places).simplices
    corners = places[faces]
    cross = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    inward = (cross * corners.mean(axis=1)).sum(axis=1) < 0
    faces[inward] = faces[inward][:, ::-1]
    normals = places.copy()
    places[7] *= 1 - bump
    return shapes.receiver(places, faces, normals)


def test_a_ball_is():
    assert is_convex(ball())


def test_a_box_with_flat_sides_is():
    assert is_convex(shapes.receiver(*shapes.box(2.0, 5, inward=False)))


def test_a_turned_box_far_away_is():
    turn, _ = np.linalg.qr(np.random.default_rng(0).normal(size=(3, 3)))
    vertices, triangles = shapes.box(2.0, 5, inward=False)
    triangles = triangles if np.linalg.det(turn) > 0 else triangles[:, ::-1]
    assert is_convex(shapes.receiver(vertices @ turn.T + 10, triangles))


@pytest.mark.parametrize("bump", [0.05, 0.3])
def test_a_dented_ball_is_not(bump):
    assert not is_convex(ball(bump))


def test_a_room_is_not():
    assert not is_convex(shapes.receiver(*shapes.box(2.0, 5, inward=True)))


def test_two_boxes_are_not():
    one, faces = shapes.box(2.0, 2, inward=False)
    both = shapes.join((one, faces), (one + np.array([5, 0, 0]), faces))
    assert not is_convex(shapes.receiver(*both))


def test_an_open_box_is_not():
    vertices, faces = shapes.box(2.0, 4, inward=False)
    assert not is_convex(shapes.receiver(vertices, faces[:-3]))


def test_a_knot_is_not():
    assert not is_convex(shapes.receiver(*shapes.torus_knot(100, 12)))


def test_a_ball_with_bent_shading_is_not():
    receiver = ball()
    receiver.normals[3] = -receiver.normals[3]
    assert not is_convex(receiver)
