"""Which texels there are, how they are read, and what fills the rest of an atlas."""

import numpy as np
import pytest
import rooms
import shapes
from prt_baker.addon.prt.steps import value_of
from prt_baker.addon.prt.surface.points import Surface
from prt_baker.addon.prt.texture import cover
from prt_baker.addon.prt.texture.cover import Layout
from prt_baker.addon.prt.texture.edges import edges_of
from prt_baker.addon.prt.texture.fill import push_pull
from prt_baker.addon.prt.texture.places import INSIDE, Mesh
from prt_baker.addon.prt.texture.sampling import bilinear, footprint
from prt_baker.addon.prt.texture.stitch import Samples, Wanted, sharpen, stitch


def some_triangles(size, count=40):
    random = np.random.default_rng(0)
    corners = random.uniform(0, size, (count, 1, 2)) + random.normal(0, size / 12, (count, 3, 2))
    corners[-1, 1:] = corners[-1, 0]  # a point
    corners[-2, 2] = corners[-2, 1]  # a line
    return Layout(np.clip(corners, -0.5, size - 0.5), size)


def covered(layout):
    return value_of(cover.cover(layout, np.ones(len(layout.corners), bool)))


def test_no_read_leaves_the_texels():
    layout, random = some_triangles(32), np.random.default_rng(1)
    index, triangles, _ = covered(layout)
    places = random.dirichlet((0.3, 0.3, 0.3), (len(layout.corners), 3000))
    read = np.einsum("fsk,fkc->fsc", places, layout.corners).reshape(-1, 2)
    texels, weights = footprint((read + 0.5) / 32, 32)
    touched = np.unique(texels[weights > 1e-9])
    assert np.isin(touched, index).all()
    assert len(index) <= len(touched) + 8  # places that random reads miss, and the margin
    assert triangles.min() >= 0


def test_a_texel_stands_on_the_triangle_under_its_centre_or_on_the_nearest():
    layout = some_triangles(32)
    index, triangles, beside = covered(layout)
    centres = np.stack([index % 32, index // 32], axis=1).astype(float)
    each = np.array(
        [cover._distances(layout.corners, np.full(len(index), k), centres) for k in range(40)]
    )
    chosen, least = each[triangles, np.arange(len(index))], each.min(axis=0)
    assert chosen[least < 1] == pytest.approx(least[least < 1], abs=1e-6)
    assert (triangles == (each <= each.min(axis=0) + 1e-9).argmax(axis=0))[chosen == 0].all()
    np.testing.assert_array_equal(beside, chosen > 2 / cover.STEPS)


def test_some_texels_are_found_as_among_all():
    layout, offset = some_triangles(64), np.array([0.3, -0.2])
    solid, some = np.ones(40, bool), np.random.default_rng(3).permutation(64 * 64)
    every = value_of(cover.locate(layout, solid, offset, np.arange(64 * 64)))
    assert (every < 0).any()
    for texels in (some[:1], some[:30], some[:2000]):
        found = value_of(cover.locate(layout, solid, offset, texels))
        np.testing.assert_array_equal(found, every[texels])


def test_the_same_texels_in_chunks_of_any_size(monkeypatch):
    layout = some_triangles(64)
    whole = covered(layout)
    monkeypatch.setattr(cover, "PAIRS", 50)
    for found, expected in zip(covered(layout), whole, strict=True):
        np.testing.assert_array_equal(found, expected)


def test_places_lie_inside_of_their_triangles():
    receiver, uvs, *_ = rooms.torus()
    mesh = Mesh.of(receiver, uvs, 64)
    index, triangles, _ = value_of(cover.cover(mesh.layout, mesh.surface.solid))
    places = mesh.places(index, triangles, np.zeros(2))
    assert places.barycentric.min() > 0
    assert places.barycentric.sum(axis=1) == pytest.approx(1)
    at = np.einsum("pk,pkc->pc", places.barycentric, mesh.layout.corners[triangles])
    away = np.abs(at - np.stack([index % 64, index // 64], axis=1)).max(axis=1)
    assert away.max() <= 1 + cover.MARGIN + 3 * INSIDE
    assert np.median(away) < INSIDE


def test_a_bilinear_read_finds_what_is_linear():
    row, column = np.mgrid[:16, :16]
    image = np.stack([row, column, 2 * row - column], axis=2).astype(np.float32)
    uvs = np.random.default_rng(0).uniform(0.5 / 16, 15.5 / 16, (100, 2))
    u, v = 16 * uvs.T - 0.5
    expected = np.stack([v, u, 2 * v - u], axis=1)
    np.testing.assert_allclose(bilinear(image, uvs), expected, atol=1e-5)
    corners = bilinear(image, np.array([[0, 0], [1, 1], [1, 0]]))
    np.testing.assert_allclose(corners[:, :2], [[0, 0], [15, 15], [0, 15]])


@pytest.mark.parametrize("size", [1, 2, 37, 64])
def test_the_rest_is_filled_from_what_is_known(size):
    random = np.random.default_rng(2)
    known = random.random((size, size)) < 0.1
    known[0, 0] = True
    image = random.uniform(1, 2, (size, size, 6)).astype(np.float32)
    before = image.copy()
    image[~known] = np.nan
    value_of(push_pull(image, known))
    np.testing.assert_array_equal(image[known], before[known])
    low, high = before[known].min(axis=0), before[known].max(axis=0)
    assert ((image >= low - 1e-5) & (image <= high + 1e-5)).all()


def test_no_mip_reads_what_is_not_known():
    known = np.zeros((64, 64), bool)
    known[5:9, 7:40], known[30:60, 50:60] = True, True
    image = np.full((64, 64, 2), 1e9, np.float32)
    image[known] = 3.0
    value_of(push_pull(image, known))
    while len(image) > 1:
        image = image.reshape(len(image) // 2, 2, len(image) // 2, 2, 2).mean(axis=(1, 3))
        np.testing.assert_allclose(image, 3, rtol=1e-6)


def test_where_nothing_is_known_all_is_black():
    image = np.full((8, 8, 3), 7, np.float32)
    value_of(push_pull(image, np.zeros((8, 8), bool)))
    assert not image.any()


def test_seams_are_the_smooth_edges_that_lie_apart():
    receiver, uvs, *_ = rooms.torus(48, 24)
    layout = Layout.of(receiver, uvs, 128)
    edges = edges_of(receiver, Surface.of(receiver), layout)
    assert len(np.unique(edges.region)) == 2
    assert len(edges.seams) == 2 * 24 + 48  # two cuts across, one around
    turned = np.linalg.norm(edges.seams[:, :, 1] - edges.seams[:, :, 0], axis=2)
    assert turned.min() > 1


def test_split_vertices_are_one_where_their_normals_agree():
    receiver, uvs, *_ = rooms.torus(48, 24)
    normals = receiver.normals[receiver.triangles.reshape(-1)]
    split = shapes.receiver(receiver.vertices[receiver.triangles.reshape(-1)],
                            np.arange(receiver.triangles.size).reshape(-1, 3), normals)  # fmt: skip
    layout = Layout.of(split, uvs, 128)
    assert len(edges_of(split, Surface.of(split), layout).seams) == 2 * 24 + 48


def test_creases_borders_and_edges_of_three_faces_are_no_seams():
    box = shapes.box(2.0, 2, inward=False)
    crease = shapes.receiver(*box)
    fan = np.array([[0, 0, 0], [0, 0, 1], [1, 0, 0], [-1, 0.1, 0], [0, 1, 0]])
    three = np.array([[0, 1, 2], [1, 0, 3], [0, 1, 4]])
    up = np.tile([0, 0, 1.0], (5, 1))
    border = shapes.grid([0, 0, 0], [1, 0, 0], [0, 1, 0], 1)
    fans = shapes.receiver(fan, three, up)
    borders = shapes.receiver(*border, np.tile([0, 0, 1.0], (4, 1)))
    for receiver, expected in ((crease, 0), (fans, 0), (borders, 1)):
        uvs = np.random.default_rng(0).random((receiver.triangles.size, 2)).astype(np.float32)
        if receiver is crease:
            uvs = rooms.planar_charts(receiver, 64)
        layout = Layout.of(receiver, uvs, 64)
        assert len(edges_of(receiver, Surface.of(receiver), layout).seams) == expected


def seam_and_flat_atlas():
    at = np.arange(64, dtype=np.int32).reshape(8, 8)
    seams = np.array([[[[3.2, 1], [3.2, 6]], [[1, 4.4], [6, 4.4]]]])  # upright and flat
    return Samples.across(seams, 8, at)


NOTHING = Samples(np.zeros((0, 4), np.int64), np.zeros((0, 4), np.float32))
NO_BORDER = Wanted(NOTHING, np.zeros((0, 1), np.float32), 1.0)


def test_a_stitch_changes_only_what_jumps():
    samples = seam_and_flat_atlas()
    assert len(samples.rows) == 11
    same = np.full((64, 2), 3, np.float32)
    value_of(stitch(same, samples, NO_BORDER, NOTHING, np.zeros(64)))
    np.testing.assert_allclose(same, 3, rtol=1e-6)
    row, column = np.mgrid[:8, :8]
    apart = np.where(row >= 4, column, row).astype(np.float32).reshape(64, 1)
    before = apart.copy()
    value_of(stitch(apart, samples, NO_BORDER, NOTHING, np.zeros(64)))
    assert np.abs(samples.read(apart)).max() < 0.2 * np.abs(samples.read(before)).max()
    read = np.isin(np.arange(64), samples.rows[np.abs(samples.weights) > 0])
    np.testing.assert_array_equal(apart[~read], before[~read])


def test_texels_outside_give_way_to_those_inside():
    samples = seam_and_flat_atlas()
    row, column = np.mgrid[:8, :8]
    outside = np.where((row == 5) | (column == 4), 0.8, 0).reshape(64)
    apart = np.where(row >= 4, column, row).astype(np.float32).reshape(64, 1)
    before = apart.copy()
    value_of(stitch(apart, samples, NO_BORDER, NOTHING, outside))
    change = np.abs(apart - before)[:, 0]
    assert change[outside > 0].max() > 4 * change[outside == 0].max()


def test_a_stitch_holds_what_was_fitted_within_texels():
    samples = seam_and_flat_atlas()
    at = np.arange(64, dtype=np.int32).reshape(8, 8)
    places = np.random.default_rng(0).uniform((2.5, 1), (3.5, 6), (40, 2))  # about a side of it
    within = Samples.at(places, 8, at)
    row, column = np.mgrid[:8, :8]
    before = np.where(row >= 4, column, row).astype(np.float32).reshape(64, 1)
    jump = np.abs(samples.read(before)).max()
    moved = []
    for held in (NOTHING, within):
        values = before.copy()
        value_of(stitch(values, samples, NO_BORDER, held, np.zeros(64)))
        assert np.abs(samples.read(values)).max() < 0.3 * jump
        moved.append(np.linalg.norm(within.read(values) - within.read(before)))
    assert moved[1] < 0.7 * moved[0]


def test_texels_follow_what_is_found_within_them_where_that_is_no_noise():
    at = np.arange(64, dtype=np.int32).reshape(8, 8)
    places = np.random.default_rng(0).uniform(1, 6, (400, 2))

    def share_found(missed, noise):
        values = np.zeros((64, 1), np.float32)
        within = Wanted.at(places, np.full((400, 1), missed, np.float32), 1.0, at)
        for _ in sharpen(values, within, 1, lambda differences: abs(differences[:, 0]), noise):
            pass
        return within.samples.read(values).mean() / missed

    assert share_found(1.0, 0.05) > 0.98
    assert share_found(0.05, 0.05) < 0.2
