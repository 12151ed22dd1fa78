"""An atlas holds every triangle once, to scale, and no chart lies near another one."""

from dataclasses import replace

import numpy as np
import pytest
import shapes
from prt_baker.addon.prt.atlas import charting, packing, pieces, uv_map
from prt_baker.addon.prt.atlas.layout import Layout
from prt_baker.addon.prt.atlas.overlap import over_any, over_each_other
from prt_baker.addon.prt.atlas.plane import plane_areas
from prt_baker.addon.prt.surface.edges import edges_of, welded
from prt_baker.addon.prt.surface.points import Surface
from scipy.spatial import cKDTree
from unwrapping import (
    bumps,
    charts_of,
    of_quads,
    outlines,
    places,
    shown_areas,
    unwrapped,
    value_of,
)

MESHES = {
    "box": lambda: shapes.receiver(*shapes.box(count=6)),
    "sphere": lambda: shapes.receiver(*shapes.sphere(24, 48)),
    "flat sphere of quads": lambda: of_quads(*shapes.sphere(12, 24)[:2]),
    "knot of quads": lambda: of_quads(*shapes.torus_knot(150, 16)),
    "bumps of quads": lambda: of_quads(*bumps()),
}


@pytest.fixture(scope="module", params=MESHES)
def mesh(request):
    """A receiver, its UVs in 256 x 256 texels, two apart."""
    receiver = MESHES[request.param]()
    return receiver, unwrapped(receiver).uvs[0]


def test_every_triangle_has_its_area_and_none_lies_over_another(mesh):
    receiver, uvs = mesh
    corners = places(receiver, uvs)
    for chart in charts_of(receiver, uvs):
        turns = np.sign(plane_areas(corners[chart]))
        assert (turns == turns[0]).all()  # a chart may be mirrored, but not folded
        assert turns[0]
        for k in range(len(chart) - 1):
            assert not over_any(corners[chart[k : k + 1]], corners[chart[k + 1 :]]).any()
    assert uv_map.problem(receiver, uvs) is None


def test_the_surface_is_sampled_evenly(mesh):
    receiver, uvs = mesh
    ratio = shown_areas(places(receiver, uvs)) / Surface.of(receiver).areas
    low, high = np.quantile(ratio / np.median(ratio), [0.02, 0.98])
    assert low > 0.6
    assert high < 1.6


@pytest.mark.parametrize("padding", [0, 1, 2, 5, 8])
def test_charts_stay_apart_and_off_the_border(padding):
    receiver = of_quads(*shapes.torus_knot(48, 8))
    atlas = unwrapped(receiver, padding=padding)
    found = outlines(receiver, atlas.uvs[0], 256)
    trees = [cKDTree(points) for points in found]
    nearest = min(trees[k].query(found[m])[0].min() for k in range(len(trees)) for m in range(k))
    assert nearest >= max(1, padding) - 0.01
    shown = np.concatenate(found)
    assert shown.min() >= padding / 2
    assert shown.max() <= 256 - padding / 2


def test_no_chart_crosses_an_edge_that_shading_breaks_at(mesh):
    receiver, uvs = mesh
    edges = edges_of(receiver, welded(receiver.vertices))
    chart = uv_map.charts(receiver, uvs)[edges.triangles]
    assert (chart[~edges.joined, 0] != chart[~edges.joined, 1]).all()


def dart():
    """A sheet creased along a line that ends in its middle: its two sides are joined around it."""
    vertices, triangles = shapes.grid([0, 0, 0], [1, 0, 0], [0, 1, 0], 16)
    vertices[:, 2] = 0.2 * np.maximum(0, 0.6 - vertices[:, 1]) * np.abs(vertices[:, 0] - 0.5)
    base = shapes.receiver(vertices, triangles)
    faces, smooth = base.normals.reshape(-1, 3, 3)[:, 0], np.zeros((len(vertices), 3))
    np.add.at(smooth, triangles.reshape(-1), np.repeat(faces, 3, axis=0))
    smooth /= np.linalg.norm(smooth, axis=1, keepdims=True)
    normals = smooth[triangles]
    creased = (vertices[triangles][..., 0] == 0.5) & (vertices[triangles][..., 1] < 0.55)
    side = vertices[triangles].mean(axis=1)[:, 0] < 0.5
    for left in (True, False):
        chosen = creased & (side == left)[:, None]
        normals[chosen] = (-0.3 if left else 0.3, 0, 0.954)
    return replace(base, normals=normals.reshape(-1, 3).astype(np.float32))


def test_a_crease_that_ends_within_a_surface_is_cut():
    receiver = dart()
    edges = edges_of(receiver, welded(receiver.vertices))
    assert 0 < (~edges.joined).sum() < 12
    uvs = unwrapped(receiver).uvs[0]
    chart = uv_map.charts(receiver, uvs)[edges.triangles]
    assert (chart[~edges.joined, 0] != chart[~edges.joined, 1]).all()
    assert len(charts_of(receiver, uvs)) <= 4


def test_flat_sides_stay_whole_and_keep_their_shape():
    receiver = shapes.receiver(*shapes.box(count=30))  # 1,800 triangles a side
    uvs = unwrapped(receiver).uvs[0]
    assert len(charts_of(receiver, uvs)) == 6
    flat, solid = places(receiver, uvs), receiver.vertices[receiver.triangles]
    sides = [np.linalg.norm(c - c[:, [1, 2, 0]], axis=2) for c in (flat, solid.astype(float))]
    ratio = sides[0] / sides[1]
    np.testing.assert_allclose(ratio, ratio.mean(), rtol=0.02)  # whole texels along each side


def test_large_meshes_are_cut_and_the_children_share_them():
    receiver = shapes.receiver(*shapes.torus_knot(500, 16))  # 16,000 triangles
    uvs = unwrapped(receiver, size=512).uvs[0]
    sizes = [len(chart) for chart in charts_of(receiver, uvs)]
    assert max(sizes) <= 2500
    assert len(sizes) < 80
    assert shown_areas(places(receiver, uvs)).sum() > 0.4


def test_long_triangles_are_cut_into_smaller_pieces():
    """For them xatlas takes longer."""
    counts = []
    for stretch in (1, 64):
        vertices, triangles, normals = bumps(80)
        wide = shapes.receiver(vertices * (stretch, 1, 1), triangles, normals)
        counts.append(value_of(pieces.pieces_of(wide, np.inf)).count)
    assert counts[0] < 20
    assert counts[1] > 2 * counts[0]


def test_the_same_mesh_gives_the_same_bytes_whatever_the_threads():
    meshes = [of_quads(*shapes.torus_knot(200, 16)), shapes.receiver(*shapes.box(count=3))]
    first, second = (unwrapped(*meshes, threads=threads) for threads in (1, 2))
    assert [u.tobytes() for u in first.uvs] == [u.tobytes() for u in second.uvs]


def test_receivers_share_an_atlas_at_one_density():
    meshes = [shapes.receiver(*shapes.box(2.0, 3)), shapes.receiver(*shapes.box(1.0, 3))]
    meshes.append(of_quads(*bumps(6)))
    atlas = unwrapped(*meshes, size=512)
    areas = [shown_areas(places(m, u)).sum() for m, u in zip(meshes, atlas.uvs, strict=True)]
    assert areas[0] / areas[1] == pytest.approx(4, rel=0.05)
    together = np.concatenate([places(m, u) for m, u in zip(meshes, atlas.uvs, strict=True)])
    assert uv_map.overlap(together) == 0


@pytest.mark.parametrize("size", [64, 256, 1024])
def test_the_atlas_is_as_large_as_asked_for(size):
    receiver = shapes.receiver(*shapes.box(count=2))
    atlas = unwrapped(receiver, size=size)
    assert atlas.size == size
    assert shown_areas(places(receiver, atlas.uvs[0])).sum() > 0.4  # six squares: at most 2 / 3


@pytest.mark.parametrize("density", [5.0, 30.0, 200.0])
def test_a_density_gives_the_smallest_square_that_holds_it(density):
    receiver = shapes.receiver(*shapes.box(size=2.0, count=2))
    atlas = unwrapped(receiver, size=0, density=density)
    area = shown_areas(places(receiver, atlas.uvs[0])).sum() * atlas.size**2
    assert (area / 24) ** 0.5 == pytest.approx(density, rel=0.1)
    assert atlas.size == 2 ** round(np.log2(atlas.size))
    half = unwrapped(receiver, size=atlas.size // 2).uvs[0]
    assert shown_areas(places(receiver, half)).sum() * (atlas.size / 2) ** 2 < area


def test_very_many_charts_are_packed_in_rows(monkeypatch):
    receiver = of_quads(*shapes.sphere(66, 132)[:2])
    monkeypatch.setattr(packing, "MANY", len(receiver.triangles) // 2 - 1)
    atlas = unwrapped(receiver, size=1024)
    assert len(charts_of(receiver, atlas.uvs[0])) == len(receiver.triangles) // 2
    assert uv_map.problem(receiver, atlas.uvs[0]) is None
    corners = places(receiver, atlas.uvs[0])
    assert shown_areas(corners).sum() > 0.25
    found = outlines(receiver, atlas.uvs[0], 1024)
    chart = np.repeat(np.arange(len(found)), [len(points) for points in found])
    points = np.concatenate(found)
    pairs = cKDTree(points).query_pairs(1.98, output_type="ndarray")
    assert (chart[pairs[:, 0]] == chart[pairs[:, 1]]).all()


def test_charts_longer_than_the_atlas_are_cut():
    x = np.arange(0, 1001.0, 5)
    vertices = np.concatenate([np.stack([x, x * 0 + y, 0.1 * x], axis=1) for y in (0, 3)])
    k = np.arange(len(x) - 1)
    quads = np.stack([k, k + 1, k + 1 + len(x), k + len(x)], axis=1)
    strip = of_quads(vertices, np.concatenate([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]]))
    uvs = unwrapped(strip, size=256).uvs[0]
    assert len(charts_of(strip, uvs)) > 1000 / 55
    assert shown_areas(places(strip, uvs)).sum() > 0.4


def test_a_chart_that_xatlas_would_shrink_does_not_fit():
    corners = np.array([[[0, 0], [1, 0], [1, 1]], [[0, 0], [1, 1], [0, 1]]]) * 100.0
    charts = charting.Charts(
        corners.reshape(-1, 2), np.arange(6).reshape(2, 3), np.zeros(2, np.int64)
    )
    assert charting.packed(charts, 128, 1.0, 0) is not None
    assert charting.packed(charts, 128, 2.0, 0) is None


def test_charts_that_touch_at_a_vertex_are_packed():
    corners = np.array([[[0, 0], [1, 0], [0.5, 1]], [[0, 0], [-1, 0], [-0.5, -1.0]]])
    charts = charting._shared(corners, np.array([[0, 1, 2], [0, 3, 4]]), np.zeros(2, np.int64))
    assert len(np.unique(charts.charts)) == 2
    assert not set(charts.triangles[0]) & set(charts.triangles[1])
    places = charting.packed(charts, 64, 16.0, 2)
    assert np.abs(plane_areas(places)) == pytest.approx([128, 128], rel=0.1)


def test_crumbs_of_a_rough_surface_are_taken_into_their_neighbours(monkeypatch):
    vertices, triangles = shapes.grid([0, 0, 0], [1, 0, 0], [0, 1, 0], 30)
    vertices[:, 2] += 0.04 * np.random.default_rng(0).standard_normal(len(vertices))
    rough = shapes.receiver(vertices, triangles, np.tile([0, 0, 1.0], (len(vertices), 1)))
    together = one_piece(rough)
    monkeypatch.setattr(charting, "join_small", lambda _: None)
    apart = one_piece(rough)
    sizes, before = (np.bincount(np.bincount(piece.charts)) for piece in (together, apart))
    assert before[1:11].sum() > 20
    assert sizes[1:11].sum() < 0.5 * before[1:11].sum()
    for chart in np.unique(together.charts):
        inside = together.uvs[together.charts == chart]
        assert not over_each_other(inside).any()
        assert (plane_areas(inside) > 0).all()
    sides = [
        np.linalg.norm(c - np.roll(c, 1, axis=1), axis=2)
        for c in (together.uvs, vertices[triangles])
    ]
    moved = together.charts != apart.charts
    assert np.quantile((sides[0] / sides[1])[moved], 0.01) > 0.3
    assert np.quantile((sides[0] / sides[1])[moved], 0.99) < 3


def one_piece(receiver):
    loops = np.arange(receiver.triangles.size).reshape(-1, 3)
    return charting._piece(receiver.vertices, receiver.triangles, loops)


def test_a_chart_that_runs_over_itself_is_taken_apart():
    """A ramp of one turn and a half, as it is seen from above."""
    angle = np.linspace(0, 3 * np.pi, 25)
    rails = [np.stack([r * np.cos(angle), r * np.sin(angle), 0.1 * angle], 1) for r in (2, 1)]
    vertices = np.concatenate(rails)
    k = np.arange(len(angle) - 1)
    inner, outer = k + len(angle), k
    triangles = np.concatenate(
        [np.stack([inner, outer, outer + 1], 1), np.stack([inner, outer + 1, inner + 1], 1)]
    )
    corners = vertices[triangles]
    loops = np.arange(triangles.size).reshape(-1, 3)
    ramp = Layout(corners, triangles, loops, corners[..., :2].copy(), np.zeros(len(k) * 2, int))
    assert over_each_other(ramp.uvs).any()
    ramp.true_to_scale()
    assert (ramp.charts < 0).any()
    ramp.mend()
    assert (ramp.charts >= 0).all()
    assert len(np.unique(ramp.charts)) > 1
    for chart in np.unique(ramp.charts):
        assert not over_each_other(ramp.uvs[ramp.charts == chart]).any()
