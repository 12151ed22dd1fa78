"""Sizes, places and shapes of triangles at the ends of what float32 can hold."""

import numpy as np
import pytest
import shapes
from prt_baker.addon.prt.errors import BakeError
from prt_baker.addon.prt.tracing.transfer import relative_rms
from stressing import (
    alone,
    bake,
    needles,
    open_error,
    receiver,
    shown,
    turned,
    visible,
)

pytestmark = pytest.mark.filterwarnings("error")

UP = [0.0, 0.0, 1.0]


def knot_at(scale=1.0, place=(0, 0, 0), **settings):
    """The transfer of a knot over a floor, both scaled and then moved."""
    vertices, triangles, normals = shapes.torus_knot(60, 10)
    floor = shapes.grid([-2.5, -2.5, -1], [5, 0, 0], [0, 5, 0], 10)
    everything, faces = shapes.join((vertices, triangles), floor)
    knot = receiver(vertices * scale + np.array(place), triangles, normals)
    return shown(bake([knot], everything * scale + np.array(place), faces, **settings))


@pytest.fixture(scope="module")
def knot():
    return knot_at()


@pytest.mark.parametrize("scale", [1e-10, 1e-4, 1e-3, 0.1, 10.0, 1e3, 1e5, 1e12])
def test_scale_changes_nothing(knot, scale, record_property):
    """Scales 1e-4 to 1e5, and 1e-10 and 1e12: the transfer is that of scale 1 to 1e-3 (RMS)."""
    error = relative_rms(knot_at(scale), knot)
    record_property("measured", error)
    assert error < 1e-3


@pytest.mark.parametrize("scale", [2.0**-13, 2.0**17])
def test_a_power_of_two_changes_no_bit(knot, scale, record_property):
    """Scales that are powers of two: the transfer is that of scale 1, bit for bit."""
    transfer = knot_at(scale)
    record_property("measured", relative_rms(transfer, knot))
    np.testing.assert_array_equal(transfer, knot)


@pytest.mark.parametrize(("distance", "scale"), [(1e6, 1.0), (1e6, 1e-3), (1e9, 1.0)])
def test_distance_from_the_origin_changes_nothing(knot, distance, scale, record_property):
    """1e6 and 1e9 away from the origin, and a thousandth of the size 1e6 away: as at the origin
    to 1e-3 (RMS)."""
    error = relative_rms(knot_at(scale, (distance, -distance, distance)), knot)
    record_property("measured", error)
    assert error < 1e-3


@pytest.mark.parametrize(("scale", "distance"), [(1e-4, 0.0), (1e5, 0.0), (1.0, 1e6)])
def test_scale_changes_no_fit(scale, distance, record_property):
    """The same with values fitted to samples inside the triangles, scales 1e-4 and 1e5, and 1e6
    from the origin: to 1e-3 (RMS)."""
    fitted = knot_at(scale, (distance, -distance, distance), fit=True)
    error = relative_rms(fitted, knot_at(fit=True))
    record_property("measured", error)
    assert error < 1e-3


@pytest.mark.parametrize("size", [1e-4, 1.0, 1e5])
@pytest.mark.parametrize("place", [0.0, 1e6])
def test_a_closed_room_is_dark_at_every_scale(size, place, record_property):
    """A closed room of 1e-4, 1 and 1e5, at the origin and 1e6 away: no point sees any sky."""
    vertices, triangles = shapes.box(size, 6)
    leak = np.abs(alone(vertices + place, triangles)).max()
    record_property("measured", leak)
    assert leak == 0


@pytest.mark.parametrize(("distance", "bound"), [(1e3, 0.01), (1e4, 0.05)])
def test_things_far_apart_lose_detail_only(distance, bound, record_property):
    """Two objects of one bake, 1e3 (1e4) apart: each as when baked alone, to 1 % (5 %, RMS)."""
    vertices, triangles, normals = shapes.torus_knot(60, 10)
    there = vertices + np.array([distance, 0, 0])
    both = [receiver(vertices, triangles, normals), receiver(there, triangles, normals)]
    scene = shapes.join((vertices, triangles), (there, triangles))
    results = bake(both, *scene, rays=2048)
    expected = alone(vertices, triangles, normals, rays=2048)
    error = max(relative_rms(shown(results, k), expected) for k in (0, 1))
    record_property("measured", error)
    assert error < bound


@pytest.mark.parametrize("size", [1e4, 1e6, 1e9])
def test_a_huge_floor_of_two_triangles(size, record_property):
    """A ball above a floor of two triangles, 1e4 to 1e9 wide: what it sees is the upper half, to
    1 % of the sky."""
    vertices, triangles, normals = shapes.sphere(8, 16)
    floor = shapes.grid([-size, -size, -1.1], [2 * size, 0, 0], [0, 2 * size, 0], 1)
    scene = shapes.join((vertices, triangles), floor)
    seen = visible(shown(bake([receiver(vertices, triangles, normals)], *scene, rays=1024)))
    error = np.abs(seen - 0.5 * (1 + normals[:, 2])).max()
    record_property("measured", error)
    assert error < 0.01


def test_a_huge_tilted_floor(record_property):
    """The same floor 1e6 wide and tilted, its corners known to 0.06: as one 1e3 wide, to 1e-2
    (RMS)."""
    vertices, triangles, normals = shapes.sphere(8, 16)
    turn = turned()

    def above(size):
        floor, faces = shapes.grid([-size, -size, -1.5], [2 * size, 0, 0], [0, 2 * size, 0], 1)
        ball = receiver(vertices @ turn.T, triangles, normals @ turn.T)
        scene = shapes.join((vertices @ turn.T, triangles), (floor @ turn.T, faces))
        return shown(bake([ball], *scene))

    error = relative_rms(above(1e6), above(1e3))
    record_property("measured", error)
    assert error < 1e-2


@pytest.mark.parametrize("aspect", [1e2, 1e4, 1e6])
def test_a_sheet_of_needles_is_open(aspect, record_property):
    """Needle triangles, 1e2 to 1e6 times longer than wide: an open sheet of them sees all of the
    sky, to 1e-5."""
    sheet, triangles = needles([0, 0, 0], [50 / aspect, 0, 0], [0, 1, 0], 50)
    error = open_error(alone(sheet, triangles), UP)
    record_property("measured", error)
    assert error < 1e-5


@pytest.mark.parametrize("count", [10, 1000])
def test_nothing_leaks_through_needles(count, record_property):
    """A closed room whose walls are needles, 10 and 1,000 a wall: no point sees any sky."""
    sides = []
    for axis in range(3):
        u, v = np.roll([2.0, 0, 0], axis + 1), np.roll([2.0, 0, 0], axis + 2)
        low, high = np.full(3, -1.0), np.full(3, -1.0)
        high[axis] = 1.0
        sides += [needles(low, u, v, count), needles(high, v, u, count)]
    vertices, triangles = shapes.join(*sides)
    room = shapes.box(1.9, 4)
    turn = turned()
    inside = receiver(room[0] @ turn.T, room[1])
    leak = np.abs(shown(bake([inside], vertices @ turn.T, triangles))).max()
    record_property("measured", leak)
    assert leak == 0


@pytest.mark.parametrize("shading", ["smooth", "flat"])
@pytest.mark.parametrize("height", [1e-2, 1e-4, 1e-6])
def test_slivers_at_t_junctions_stay_open(height, shading, record_property):
    """A sheet with a sliver where a vertex lies 1e-2 to 1e-6 beside its neighbour's edge: sees
    all of the sky, to 1e-2."""
    flat = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0], [0.5, height, 0]])
    triangles = np.array([[0, 4, 3], [4, 2, 3], [4, 1, 2], [0, 1, 4]])
    errors = []
    for turn in map(turned, range(8)):
        vertices = (flat @ turn.T).astype(np.float32)
        normals = None if shading == "flat" else np.tile(turn[:, 2], (5, 1))
        errors.append(1 - visible(alone(vertices, triangles, normals)).min())
    record_property("measured", max(errors))
    assert max(errors) < 1e-2


def test_faces_without_area_change_nothing(record_property):
    """Zero-area triangles in a mesh: they show no point, and all others show the same bits."""
    vertices, triangles, normals = shapes.torus_knot(30, 8)
    a, b, c = triangles[::5].T
    flat = np.concatenate([np.stack([a, b, b], 1), np.stack([c, c, c], 1)])
    more = np.concatenate([triangles, flat])
    error = np.abs(alone(vertices, more, normals) - alone(vertices, triangles, normals)).max()
    record_property("measured", error)
    assert error == 0
    corners = receiver(vertices, more)
    result = bake([corners], vertices, more).receivers[0]
    assert (result.element_points[3 * len(triangles) :] == -1).all()
    assert not result.at_elements(result.transfer)[3 * len(triangles) :].any()


def test_a_mesh_of_faces_without_area_is_refused():
    """A mesh with no area at all beside a sound one, given to the engine itself: refused in one
    sentence that names it, as on Blender's side."""
    line = np.array([[0.0, 0, 0], [1, 0, 0], [2, 0, 0]]), np.array([[0, 1, 2]])
    sheet = shapes.grid([0, 0, 0], [1, 0, 0], [0, 1, 0], 2)
    subjects = [receiver(*sheet, name="Sheet"), receiver(*line, name="Line")]
    with pytest.raises(BakeError, match="'Line' has only faces without area"):
        bake(subjects, *shapes.join(sheet, line))
