"""Meshes that are thin, doubled, flipped, folded into each other, or no surface at all."""

import numpy as np
import pytest
import shapes
from prt_baker.addon.prt.tracing.transfer import relative_rms
from stressing import alone, bake, open_error, receiver, shown, turned, visible
from test_transfer import integral

pytestmark = pytest.mark.filterwarnings("error")

UP = [0.0, 0.0, 1.0]
OFFSET = 2.0**-19  # where rays start off a surface, for coordinates about 1


def sheet(count=4, height=0.0, size=1.0):
    """A square about the z axis, facing up."""
    half = size / 2
    return shapes.grid([-half, -half, height], [size, 0, 0], [0, size, 0], count)


def flipped(mesh):
    return mesh[0], mesh[1][:, ::-1]


def globe():
    """A closed ball of triangles that don't meet at right angles."""
    vertices, triangles = shapes.box(2.0, 6, inward=False)
    normals = vertices / np.linalg.norm(vertices, axis=1, keepdims=True)
    return normals @ turned().T, triangles, normals @ turned().T


def test_coincident_faces_stay_open(record_property):
    """Two coincident sheets that face the same way, and a pair that face away from each other:
    every side sees all of its sky, to 1e-5."""
    same, away = shapes.join(sheet(), sheet(3)), shapes.join(sheet(), flipped(sheet()))
    normals = np.repeat([UP, [0.0, 0, -1.0]], len(away[1]) // 2 * 3, axis=0)
    error = max(open_error(alone(*same), UP), open_error(alone(*away), normals))
    record_property("measured", error)
    assert error < 1e-5


def test_a_box_standing_exactly_on_a_floor(record_property):
    """A box whose bottom lies in the floor: the floor around it shows the bits that it shows
    around a box without a bottom."""
    floor = sheet(11, 0.0, 5.0)
    box, triangles = shapes.box(1.0, 3, inward=False)
    box = box + np.array([0, 0, 0.5])
    bottom = (box[triangles][:, :, 2] == 0).all(axis=1)
    place = floor[0][floor[1].reshape(-1)]
    outside = np.abs(place[:, :2]).max(axis=1) > 0.5
    with_, without = (
        shown(bake([receiver(*floor)], *shapes.join(floor, (box, some))))[outside]
        for some in (triangles, triangles[~bottom])
    )
    error = relative_rms(with_, without)
    record_property("measured", error)
    np.testing.assert_array_equal(with_, without)


def test_a_sheet_stops_light_from_both_sides(record_property):
    """A one-sided sheet over a floor: the same bits whichever way it faces, and none of the light
    that comes through it."""
    floor, above = sheet(4), sheet(1, 0.5, 2.0)
    ways = [
        shown(bake([receiver(*floor)], *shapes.join(floor, cover)))
        for cover in (above, flipped(above))
    ]
    record_property("measured", relative_rms(*ways))
    np.testing.assert_array_equal(*ways)
    assert visible(ways[0]).max() < 0.5


def test_a_sheet_sees_the_side_that_it_faces(record_property):
    """The one-sided sheet itself, tilted: it sees all of the sky in front of it, to 1e-5."""
    turn = turned()
    vertices, triangles = sheet(5)
    error = open_error(alone(vertices @ turn.T, triangles), turn[:, 2])
    record_property("measured", error)
    assert error < 1e-5


@pytest.mark.parametrize("thickness", [1e-3, 1e-6, 1e-7, 1e-9, 0.0])
def test_walls_thinner_than_the_offset_hold(thickness, record_property):
    """A room of 2 with walls 1e-3 to 0 thick (rays start 2e-6 off them): dark inside, and outside
    all of the sky, to 1e-5."""
    inside = receiver(*shapes.box(2.0, 4, inward=True), name="inside")
    outside = receiver(*shapes.box(2.0 + 2 * thickness, 4, inward=False), name="outside")
    scene = shapes.join(*((r.vertices, r.triangles) for r in (inside, outside)))
    results = bake([inside, outside], *scene)
    leak = np.abs(shown(results, 0)).max()
    error = open_error(shown(results, 1), outside.normals)
    record_property("measured", max(leak, error))
    assert leak == 0
    assert error < 1e-5


@pytest.mark.parametrize("thickness", [1e-2, 1e-5, 1e-7, 1e-9])
def test_a_slab_thinner_than_the_offset_is_open(thickness, record_property):
    """A slab 1e-2 to 1e-9 thick, its narrow sides included: all of the sky, to 1e-5."""
    vertices, triangles = shapes.box(1.0, 3, inward=False)
    slab = receiver(vertices * [1, thickness, 1], triangles)
    error = open_error(alone(slab.vertices, triangles), slab.normals)
    record_property("measured", error)
    assert error < 1e-5


@pytest.mark.parametrize(("height", "seen"), [(0.25, 1.0), (0.75, 1.0), (2.0, 0.0), (16.0, 0.0)])
def test_what_lies_nearer_than_the_offset_casts_no_shadow(height, seen, record_property):
    """A cover over a sheet, 1/4 to 16 offsets above: below one offset the sheet is open, from two
    on it is dark."""
    size = 2.0
    floor, cover = sheet(3, 0.0, size), sheet(1, height * OFFSET, 2e3)
    transfer = shown(bake([receiver(*floor)], *shapes.join(floor, cover)))
    error = np.abs(visible(transfer) - seen).max()
    record_property("measured", error)
    assert error < 1e-5


def test_flipped_faces_are_dark_and_hurt_no_other(record_property):
    """Every seventh triangle of a closed box flipped: those, which look inside, are dark; the rest
    sees all of its sky, to 1e-5."""
    vertices, triangles = shapes.box(2.0, 6, inward=False)
    wrong = np.arange(len(triangles)) % 7 == 0
    box = receiver(vertices @ turned().T, np.where(wrong[:, None], triangles[:, ::-1], triangles))
    corners = np.repeat(wrong, 3)
    transfer = shown(bake([box], box.vertices, box.triangles))
    error = open_error(transfer[~corners], box.normals[~corners])
    record_property("measured", error)
    assert error < 1e-5
    assert not transfer[corners].any()


def test_a_mesh_inside_out_is_dark(record_property):
    """A closed ball, smooth, turned inside out: every point is dark, none is given a neighbour's
    light."""
    vertices, triangles, normals = globe()
    transfer = alone(vertices, triangles[:, ::-1], -normals)
    record_property("measured", np.abs(transfer).max())
    assert not transfer.any()


@pytest.mark.parametrize("kind", ["opposite", "zero", "nan", "infinite", "huge", "random"])
def test_wrong_shading_normals_stay_in_bounds(kind, record_property):
    """Shading normals that are opposite, zero, NaN, infinite, 1e38 long or random: finite, between
    none and all of the sky; zero, NaN and infinite ones are replaced by the face's."""
    vertices, triangles, good = globe()
    normals = {
        "opposite": -good,
        "zero": 0 * good,
        "nan": np.full_like(good, np.nan),
        "infinite": np.full_like(good, np.inf),
        "huge": 1e38 * good,
        "random": np.random.default_rng(0).normal(size=good.shape),
    }[kind]
    seen = visible(alone(vertices, triangles, normals))
    beyond = max(0.0, -seen.min(), seen.max() - 1)
    record_property("measured", beyond)
    assert np.isfinite(seen).all()
    assert beyond < 1e-5
    if kind in ("zero", "nan", "infinite"):
        assert seen.min() > 0.99
    if kind == "huge":
        assert seen.min() > 1 - 1e-5


def test_a_ball_half_sunk_into_a_floor(record_property):
    """Two meshes that cut each other: what the floor sees beside a ball sunk to its middle is the
    closed form to 2 % (the ball is one of flat faces)."""
    vertices, triangles, _ = shapes.sphere(96, 192)
    place = np.array([[x, y, 0.0] for x in (1.5, 2.0, 3.0) for y in (0.0, 0.5)])
    patches = [
        (p + 0.02 * np.array([[-1, -1, 0], [1, -1, 0], [0, 1.5, 0]]), np.array([[0, 1, 2]]))
        for p in place
    ]
    floor = shapes.join(sheet(1, -1e-3, 50.0), *patches)
    patch = receiver(*shapes.join(*patches))
    got = shown(bake([patch], *shapes.join((vertices, triangles), floor), rays=2048))
    errors = []
    for k, point in enumerate(patch.vertices[patch.corner_vertices]):
        distance = np.hypot(*point[:2])
        towards = np.append(point[:2], 0) / -distance

        def clear(theta, phi, towards=towards, distance=distance):
            sine = np.sin(theta)
            along = sine * np.cos(phi) * towards[0] + sine * np.sin(phi) * towards[1]
            return (along < np.sqrt(1 - 1 / distance**2)).astype(float)

        errors.append(relative_rms(got[k], integral(clear, 3)))
    record_property("measured", max(errors))
    assert max(errors) < 0.02


@pytest.mark.parametrize("sheets", [3, 4, 6, 12, 72])
def test_a_fan_of_sheets_on_one_edge(sheets, record_property):
    """3 to 72 half-planes that share an edge, both faces of each: points at that edge see the
    (1 - cos a) / 2 of their wedge to 0.01 of the sky."""
    width, angle = 1e3, 2 * np.pi / sheets
    fan = []
    for k in range(sheets):
        out = width * np.array([np.cos(k * angle), np.sin(k * angle), 0])
        fan.append(shapes.grid([0, 0, -width], out, [0, 0, 2 * width], 4))
    vertices, triangles = shapes.join(*fan)
    triangles = np.concatenate([triangles, triangles[:, ::-1]])
    seen = visible(alone(vertices, triangles, rays=1024))
    place = vertices[triangles.reshape(-1)]
    at_edge = np.hypot(place[:, 0], place[:, 1]) < 1e-6
    middle = at_edge & (np.abs(place[:, 2]) < 1e-6)
    error = np.abs(seen[middle] - (1 - np.cos(angle)) / 2).max()
    record_property("measured", error)
    assert error < 0.01


def moebius(count=40):
    """A strip with half a turn, one-sided, its vertex normals pointing both ways."""
    t = np.linspace(0, 2 * np.pi, count, endpoint=False)
    ring = np.stack([np.cos(t), np.sin(t), 0 * t], 1)
    across = np.cos(t / 2)[:, None] * ring + np.sin(t / 2)[:, None] * np.array(UP)
    vertices = np.concatenate([ring - 0.3 * across, ring + 0.3 * across])
    k, following = np.arange(count), (np.arange(count) + 1) % count
    here, there = (k, k + count), (following, following + count)
    there = tuple(np.where(k == count - 1, there[1 - i], there[i]) for i in (0, 1))
    triangles = [
        np.stack([here[0], there[0], there[1]], 1),
        np.stack([here[0], there[1], here[1]], 1),
    ]
    return vertices, np.concatenate(triangles)


def bow_ties():
    """Cones that touch in one vertex, each also there a second time and crossed by a sheet."""
    vertices, triangles, _ = globe()
    cone = vertices[triangles.reshape(-1)].copy()
    cone[::3] = 0
    return shapes.join((cone, np.arange(len(cone)).reshape(-1, 3)), (vertices, triangles), sheet(3))


@pytest.mark.parametrize("make", [moebius, bow_ties])
def test_non_manifold_meshes_are_measured_as_sound_ones(make, record_property):
    """A Möbius strip; cones that share one vertex, doubled and cut by a sheet: between none and all
    of the sky, and measured at the points the error stays below 5 %."""
    vertices, triangles = make()
    results = bake([receiver(vertices, triangles)], vertices, triangles,
                   verify_points=60, verify_rays=2048)  # fmt: skip
    seen = visible(results.receivers[0].transfer[:, 0])
    assert -1e-6 < seen.min() <= seen.max() < 1 + 1e-5
    error = results.report["objects"][0]["measured_error"]["at_points"]
    record_property("measured", error)
    assert error < 0.05


@pytest.mark.parametrize("scale", [1e-4, 1.0, 1e5])
def test_inner_corners_see_their_open_part(scale, record_property):
    """The corner of three walls, at scales 1e-4 to 1e5: the floor's point there has the transfer
    of a quarter of the sky, all nine coefficients, to 5e-3."""
    far = 1e3
    walls = shapes.join(
        shapes.grid([0, 0, 0], [far, 0, 0], [0, far, 0], 2),
        shapes.grid([0, 0, 0], [0, far, 0], [0, 0, far], 2),
        shapes.grid([0, 0, 0], [0, 0, far], [far, 0, 0], 2),
    )
    walls = walls[0] * scale, walls[1]
    transfer = alone(*walls, rays=4096)
    place = walls[0][walls[1].reshape(-1)]
    expected = integral(lambda theta, phi: (phi < np.pi / 2).astype(float), 3)
    floor = np.repeat(np.arange(len(walls[1])) < len(walls[1]) // 3, 3)
    corner = floor & (np.abs(place).max(axis=1) == 0)
    error = np.abs(transfer[corner] - expected).max()
    record_property("measured", error)
    assert error < 5e-3


def solid(vertices):
    """The convex body of a few ``vertices`` with one triangle for each three that bound it."""
    faces = []
    for a in range(len(vertices)):
        for b in range(len(vertices)):
            for c in range(max(a, b) + 1, len(vertices)):
                normal = np.cross(vertices[b] - vertices[a], vertices[c] - vertices[a])
                if a != b and ((vertices - vertices[a]) @ normal < 1e-9).all():
                    faces.append([a, b, c])
    return vertices, np.array(faces), vertices / np.linalg.norm(vertices, axis=1, keepdims=True)


CORNERS = {
    "tetrahedron": [[1, 1, 1], [1, -1, -1], [-1, 1, -1], [-1, -1, 1]],
    "octahedron": np.concatenate([np.eye(3), -np.eye(3)]),
}


@pytest.mark.parametrize("kind", list(CORNERS))
def test_the_coarsest_smooth_solids_do_not_shadow_themselves(kind, record_property):
    """Smooth normals on a tetrahedron and an octahedron: all of the sky about each vertex normal,
    to 1e-5."""
    vertices, triangles, normals = solid(np.array(CORNERS[kind], float) @ turned().T)
    error = open_error(alone(vertices, triangles, normals), normals)
    record_property("measured", error)
    assert error < 1e-5


def torus(rows, columns):
    a = 2 * np.pi * np.arange(rows)[:, None] / rows
    b = 2 * np.pi * np.arange(columns)[None] / columns
    normals = np.stack([np.cos(a) * np.cos(b), np.sin(a) * np.cos(b), np.sin(b) + 0 * a], -1)
    ring = np.stack([np.cos(a) + 0 * b, np.sin(a) + 0 * b, 0 * (a + b)], -1)
    vertices, triangles = shapes.wrapped(ring + 0.4 * normals, rows, columns)
    return vertices, triangles, normals.reshape(-1, 3)


@pytest.mark.parametrize(
    ("rows", "columns", "bound"), [(6, 8, 0.06), (12, 8, 0.03), (24, 16, 0.02)]
)
def test_smooth_normals_on_a_coarse_mesh(rows, columns, bound, record_property):
    """Shadow terminator: a smooth torus of 6x8, 12x8 and 24x16 quads agrees at its vertices with
    one of 96x64 to 6, 3 and 2 % (RMS)."""
    fine = alone(*torus(96, 64)).reshape(96, 64, 9)
    coarse = alone(*torus(rows, columns)).reshape(rows, columns, 9)
    error = relative_rms(coarse, fine[:: 96 // rows, :: 64 // columns])
    record_property("measured", error)
    assert error < bound


def test_open_concave_normals_lose_only_what_is_hidden(record_property):
    """A smooth bowl of 8x8 quads, seen from inside: at most 5 % (RMS) from one of 64x64."""

    def bowl(count):
        vertices, triangles = sheet(count, 0.0, 2.0)
        vertices = vertices + np.array(UP) * 0.5 * (vertices[:, :2] ** 2).sum(axis=1)[:, None]
        normals = vertices * [-1, -1, 0] + UP
        return vertices, triangles, normals / np.linalg.norm(normals, axis=1, keepdims=True)

    fine = alone(*bowl(64)).reshape(65, 65, 9)[::8, ::8]
    error = relative_rms(alone(*bowl(8)).reshape(9, 9, 9), fine)
    record_property("measured", error)
    assert error < 0.05


def test_a_soup_of_triangles_stays_in_bounds(record_property):
    """300 random triangles through each other, both as receiver and occluder: finite, between none
    and all of the sky; measured at the points the error stays below 5 %."""
    rng = np.random.default_rng(4)
    vertices = (rng.uniform(-1, 1, (300, 1, 3)) + rng.normal(0, 0.3, (300, 3, 3))).reshape(-1, 3)
    triangles = np.arange(900).reshape(-1, 3)
    results = bake([receiver(vertices, triangles)], vertices, triangles,
                   verify_points=100, verify_rays=4096)  # fmt: skip
    seen = visible(results.receivers[0].transfer[:, 0])
    assert -1e-6 < seen.min() <= seen.max() < 1 + 1e-5
    error = results.report["objects"][0]["measured_error"]["at_points"]
    record_property("measured", error)
    assert error < 0.05


def test_two_hundred_faces_on_one_another(record_property):
    """200 coincident copies of one sheet: all of the sky, to 1e-5."""
    pile = shapes.join(*[sheet(2)] * 200)
    error = open_error(alone(*pile), UP)
    record_property("measured", error)
    assert error < 1e-5


def knot_with_needless_faces():
    """A coarse smooth knot with faces of no area and faces twice."""
    vertices, triangles, normals = shapes.torus_knot(60, 10)
    a, b, _ = triangles[::5].T
    return vertices, np.concatenate([triangles, np.stack([a, b, b], 1), triangles[::7]]), normals


def inside_out():
    vertices, triangles, _ = globe()
    return vertices, triangles[:, ::-1]


@pytest.mark.parametrize("tolerance", [0.0, 0.02])
@pytest.mark.parametrize("make", [moebius, bow_ties, inside_out, knot_with_needless_faces])
def test_fitted_values_stay_in_bounds(make, tolerance, record_property):
    """A Möbius strip, cones on one vertex, a ball inside out, a knot with doubled and empty faces,
    where they pay with values fitted to samples, at a fixed count of rays and at a tolerance:
    finite, at most 0.05 of the sky below none or above all of it."""
    vertices, triangles, *normals = make()
    subject = [receiver(vertices, triangles, *normals)]
    results = bake(subject, vertices, triangles, fit=True, tolerance=tolerance)
    seen = visible(results.receivers[0].transfer[:, 0])
    beyond = max(0.0, -seen.min(), seen.max() - 1)
    record_property("measured", beyond)
    assert np.isfinite(results.receivers[0].transfer).all()
    assert beyond < 0.05
    if normals:
        assert results.report["objects"][0]["values"]["fitted"] > 0.5
