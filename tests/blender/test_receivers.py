"""Receivers are what Blender shows, in the world's space, with normals that point out."""

from math import pi

import bpy
import numpy as np
import pytest
from mathutils import Matrix
from meshes import MIRRORED, SHEARED, TURNED, ball, cube, geometric_normals, place, receiver_of


@pytest.mark.parametrize("matrix", [Matrix(), MIRRORED, SHEARED, TURNED])
@pytest.mark.parametrize("make", [cube, ball, lambda: ball(smooth=False)])
def test_normals_point_out_of_every_closed_mesh(scene, make, matrix):
    obj = place(make(), matrix=matrix)
    got = receiver_of(obj)
    faces = geometric_normals(got.vertices, got.triangles)
    centres = got.vertices[got.triangles].mean(axis=1) - np.array(matrix.translation)
    assert (np.einsum("fk,fk->f", faces, centres) > 0).all()
    shading = got.normals[got.triangle_corners if got.domain == "CORNER" else got.triangles]
    assert (np.einsum("fck,fk->fc", shading, faces) > 0).all()
    np.testing.assert_allclose(np.linalg.norm(got.normals, axis=1), 1, atol=1e-6)


@pytest.mark.parametrize("matrix", [MIRRORED, SHEARED, TURNED])
def test_shading_normals_stay_perpendicular_to_the_surface(scene, matrix):
    mesh = ball()
    here = receiver_of(place(mesh, matrix=matrix))
    local = receiver_of(place(mesh)).normals.astype(np.float64)
    for other in np.eye(3):
        tangents = np.cross(local, other) @ np.array(matrix)[:3, :3].T
        assert np.abs(np.einsum("vk,vk->v", tangents, here.normals)).max() < 1e-6


def test_a_flattened_mesh_still_has_unit_normals(scene):
    got = receiver_of(place(ball(), matrix=Matrix.Diagonal((1, 1, 0, 1))))
    np.testing.assert_allclose(np.linalg.norm(got.normals, axis=1), 1, atol=1e-6)


@pytest.mark.parametrize("make", [cube, ball])
def test_triangles_are_their_corners_vertices(scene, make):
    got = receiver_of(place(make(), matrix=MIRRORED))
    np.testing.assert_array_equal(got.corner_vertices[got.triangle_corners], got.triangles)
    for array in (got.triangles, got.triangle_corners, got.corner_vertices):
        assert array.dtype == np.int32
    assert got.vertices.dtype == np.float64
    assert got.normals.dtype == np.float32


def test_smooth_shading_is_per_vertex_and_any_sharp_edge_per_corner(scene):
    obj = place(ball())
    got = receiver_of(obj)
    assert got.domain == "POINT"
    assert len(got.normals) == len(obj.data.vertices)
    obj.data.edges[0].use_edge_sharp = True
    obj.data.update()
    got = receiver_of(obj)
    assert got.domain == "CORNER"
    assert len(got.normals) == len(obj.data.loops)


def test_polygons_of_many_corners_keep_their_area(scene):
    mesh = bpy.data.meshes.new("Arrow")  # concave: a fan would cover too much
    outline = [(0, 0, 0), (2, -1, 0), (1, 0, 0), (2, 1, 0)]
    circle = [(5 + np.cos(a), np.sin(a), 0) for a in np.arange(7) * 2 * pi / 7]
    mesh.from_pydata(outline + circle, [], [range(4), range(4, 11)])
    got = receiver_of(place(mesh))
    area = np.linalg.norm(geometric_normals(got.vertices, got.triangles), axis=1).sum() / 2
    assert area == pytest.approx(1 + 7 / 2 * np.sin(2 * pi / 7), rel=1e-5)


def test_modifiers_and_shape_keys_are_read_evaluated(scene):
    obj = place(cube())
    obj.modifiers.new("Subdivision", "SUBSURF").levels = 2
    assert len(receiver_of(obj).vertices) == 98
    obj.modifiers.clear()
    obj.shape_key_add(name="Basis")
    key = obj.shape_key_add(name="Up")
    for point in key.data:
        point.co.z += 3
    key.value = 0.5
    bpy.context.view_layer.update()
    assert receiver_of(obj).vertices[:, 2].max() == pytest.approx(2.5)


def test_world_positions_keep_what_float32_would_lose(scene):
    obj = place(ball(), matrix=Matrix.Translation((65536, 0, 0)))
    local = np.array([v.co for v in obj.data.vertices], np.float64)
    np.testing.assert_array_equal(receiver_of(obj).vertices[:, 0] - 65536, local[:, 0])


def test_free_normals_at_vertices_are_those_that_shade(scene):
    obj = place(ball())
    up = np.tile(np.float32((0, 0, 1)), (len(obj.data.vertices), 1))
    obj.data.normals_split_custom_set_from_vertices(up)
    obj.data.update()
    bpy.context.view_layer.update()
    np.testing.assert_allclose(receiver_of(obj).normals[:, 2], 1, atol=1e-3)
