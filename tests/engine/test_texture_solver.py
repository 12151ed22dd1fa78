"""Values of texels: few are traced, the errors are no larger, seams and corners are clean."""

from functools import cache

import numpy as np
import pytest
import rooms
import shapes
from prt_baker.addon.prt.job import Settings
from prt_baker.addon.prt.steps import value_of
from prt_baker.addon.prt.surface.points import Points, Surface, element_triangles
from prt_baker.addon.prt.surface.samples import random_places, starts
from prt_baker.addon.prt.texture import cover, refine, solver
from prt_baker.addon.prt.texture.edges import edges_of
from prt_baker.addon.prt.texture.places import Mesh, pilot_points
from prt_baker.addon.prt.texture.sampling import bilinear
from prt_baker.addon.prt.tracing import rays, transfer
from prt_baker.addon.prt.tracing.buried import OPEN, buried
from prt_baker.addon.prt.vertex import traced


class Bench:
    """A receiver in an atlas, the truth at random places of its surface, and its bake."""

    def __init__(self, receiver, uvs, vertices, triangles, size):
        self.receiver, self.uvs, self.size = receiver, uvs, size
        self.sky = rays.occlusion(vertices, triangles)
        self.mesh = Mesh.of(receiver, uvs, size)
        self.index, self.triangles, _ = value_of(
            cover.cover(self.mesh.layout, self.mesh.surface.solid)
        )

    def found(self, origins, normals, count, seed=0, threads=2):
        values = np.empty((len(origins), 9), np.float32)
        where = Points(np.asarray(origins, np.float32), np.asarray(normals, np.float32), None)
        settings = Settings(rays=count, seed=seed, threads=threads)
        value_of(transfer.trace_all(where, self.sky, settings, values))
        return values

    def truth(self, count=1500, rays=8192):
        surface = Surface.of(self.receiver)
        places = random_places(surface.areas, count, 3)
        where = starts(surface, element_triangles(self.receiver), self.receiver.normals, places)
        where = [w.astype(np.float32) for w in where]
        values = self.found(*where, rays, 9)
        seen = ~buried(*where, values, self.sky)
        corners = self.uvs[self.receiver.triangle_corners[places.triangles]]
        uvs = np.einsum("pk,pkc->pc", places.barycentric, corners)
        return uvs[seen], values[seen], where[0][seen]

    def every_texel(self, count):
        places = self.mesh.places(self.index, self.triangles, np.zeros(2))
        origins, normals = self.mesh.starts(places)
        values = self.found(origins, normals, count)
        return values, buried(origins, normals, values, self.sky)

    def solve(self, count, noise, extra=None, light=None, threads=2, **settings):
        def trace(origins, normals, rays):
            yield 0
            values = self.found(origins, normals, rays, threads=threads)
            if extra is not None:
                values = np.concatenate([values, extra(origins)], axis=1)
            yield len(origins) * rays
            return values

        return value_of(
            solver.solve(
                self.receiver, self.uvs, self.size, trace, self.sky, Settings(**settings),
                rays=count, noise=noise, light=light,
            )
        )  # fmt: skip

    def image(self, index, values):
        image = np.zeros((self.size**2, values.shape[1]), np.float32)
        image[index] = values
        return image.reshape(self.size, self.size, -1)

    def errors(self, image):
        uvs, truth, _ = self.known
        missed = bilinear(image, uvs)[:, :9] - truth
        return np.sqrt(np.mean(missed**2, axis=1) / np.mean(truth**2))


@cache
def bench(name):
    if name == "room":
        receiver, vertices, triangles = rooms.room()
        made = Bench(receiver, rooms.planar_charts(receiver, 512), vertices, triangles, 512)
    else:
        made = Bench(*rooms.torus(96, 48), 192)
    made.known = made.truth()
    return made


BAKES = {"room": (512, 0.035), "torus": (256, 0.012)}  # rays and the noise that they leave


@cache
def baked(name):
    return bench(name).solve(*BAKES[name])


def rms(values):
    return float(np.sqrt(np.mean(np.square(values))))


def test_a_room_takes_an_eighth_of_the_rays_and_has_no_larger_errors():
    scene, found = bench("room"), baked("room")
    values, hidden = scene.every_texel(512)
    values[hidden] = 0
    known = ~hidden
    grid = refine.Grid.of(512, scene.index, edges_of(
        scene.receiver, scene.mesh.surface, scene.mesh.layout).region[scene.triangles])  # fmt: skip
    solver.grow(grid, values, known, 2)
    every = scene.errors(scene.image(scene.index, values))
    ours = scene.errors(scene.image(found.index, found.values))
    assert found.entry["rays"] < 0.13 * 512 * len(scene.index)
    assert rms(ours) < rms(every)
    assert np.quantile(ours, 0.99) < np.quantile(every, 0.99)


def test_a_smooth_surface_takes_few_rays():
    scene, found = bench("torus"), baked("torus")
    assert found.entry["rays"] < 0.25 * 256 * len(scene.index)
    assert rms(scene.errors(scene.image(found.index, found.values))) < 0.01


@pytest.mark.parametrize("name", ["room", "torus"])
def test_the_report_knows_the_error(name):
    scene, found = bench(name), baked(name)
    true = rms(scene.errors(scene.image(found.index, found.values)))
    assert 0.6 < found.entry["surface_error"] / true < 1.6
    counts = [found.entry[k] for k in ("traced_texels", "interpolated_texels", "filled_texels")]
    assert sum(counts) == found.entry["texels"] == len(found.index)


def test_reads_along_seams_meet():
    scene, found = bench("torus"), baked("torus")
    edges = edges_of(scene.receiver, scene.mesh.surface, scene.mesh.layout)
    along = np.random.default_rng(4).random((10000, 1, 1))
    which = np.random.default_rng(5).integers(len(edges.seams), size=10000)
    ends = edges.seams[which]
    places = (1 - along) * ends[:, :, 0] + along * ends[:, :, 1]
    image = scene.image(found.index, found.values)
    sides = [bilinear(image, (places[:, k] + 0.5) / scene.size) for k in range(2)]
    jumps = np.sqrt(np.mean((sides[0] - sides[1]) ** 2, axis=1))
    grid = refine.Grid.of(scene.size, found.index, edges.region[scene.triangles])
    right = grid.neighbours(np.arange(len(found.index)), [(0, 1)])[:, 0]
    step = found.values[right[right >= 0]] - found.values[right >= 0]
    steps = np.sqrt(np.mean(step**2, axis=1))
    assert np.quantile(jumps, 0.999) < 0.15 * np.quantile(steps, 0.999)
    assert jumps.max() < 0.25 * steps.max()
    assert found.entry["seams"]["jump_after"] < 0.3 * found.entry["seams"]["jump_before"]


@pytest.mark.parametrize("name", ["room", "torus"])
def test_a_stitch_does_not_raise_the_error(name, monkeypatch):
    scene, found = bench(name), baked(name)
    monkeypatch.setattr(solver, "stitch", lambda *_: iter(()))
    apart = scene.solve(*BAKES[name])
    ours, before = (rms(scene.errors(scene.image(f.index, f.values))) for f in (found, apart))
    assert ours < 1.001 * before
    changed = (found.values != apart.values).any(axis=1)
    assert 0 < changed.mean() < 0.4


def folded_sheet(width):
    """A sheet with a fold to and fro, ``width`` wide and smooth in its shading, and how far along
    itself (17,) its rows of vertices lie; the fold is between 0.45 and 0.45 + 3 ``width``."""
    bends = 0.45 + width * np.arange(1, 4)
    along = np.concatenate([np.linspace(0, 0.45, 8), bends, np.linspace(0.5, 0.9, 6)])
    x, height = along.copy(), np.zeros(17)
    x[9:] -= 2 * width
    x[9] = 0.45
    height[9], height[10:] = 0.2 * width, 0.4 * width
    vertices, triangles = shapes.grid([0, 0, 0], [1, 0, 0], [0, 0.95, 0], 16)
    vertices[:, 0], vertices[:, 2] = np.repeat(x, 17), np.repeat(height, 17)
    return shapes.receiver(vertices, triangles, np.tile([0, 0, 1.0], (289, 1))), along


def test_a_fold_within_a_texel_draws_no_dark_line():
    """Its back, where a column of texels has its centres, sees nothing; what is beside it does."""
    size, column = 64, 32
    receiver, along = folded_sheet(0.2 / size)
    flat = np.stack([np.repeat(along, 17) + 3.4 / size, 0.02 + receiver.vertices[:, 1]], axis=1)
    uvs = flat[receiver.corner_vertices].astype(np.float32)
    scene = Bench(receiver, uvs, receiver.vertices, receiver.triangles, size)
    every, _ = scene.every_texel(64)
    assert np.median(every[scene.index % size == column, 0]) < 0.05 * OPEN
    found = scene.solve(256, 0.01)
    places = np.random.default_rng(0).uniform(0.06, 0.94, (4000, 2))
    read = bilinear(scene.image(found.index, found.values), places)[:, 0]
    np.testing.assert_allclose(read, OPEN, rtol=0.03)


def test_creases_read_what_was_found_at_them():
    """On the border of a chart the reads find what was traced there, in the corners of a room."""
    scene, found = bench("room"), baked("room")
    origins = scene.known[2]
    near = np.minimum(origins[:, 2], rooms.HEIGHT - origins[:, 2]) < 0.02
    errors = scene.errors(scene.image(found.index, found.values))
    assert near.sum() > 20
    assert rms(errors[near]) < 1.5 * rms(errors)


def test_the_same_bits_for_any_threads_and_batches(monkeypatch):
    scene, first = bench("torus"), baked("torus")
    monkeypatch.setattr(transfer, "BATCH_RAYS", 8192)
    monkeypatch.setattr(refine, "PIECE", 1000)
    monkeypatch.setattr(cover, "PAIRS", 3000)
    again = scene.solve(256, 0.012, threads=1)
    np.testing.assert_array_equal(again.index, first.index)
    np.testing.assert_array_equal(again.values, first.values)
    assert again.entry == first.entry


def floor_and_crate():
    floor = shapes.grid([-1, -1, 0], [2, 0, 0], [0, 2, 0], 1)
    crate = rooms.block((-0.4, -0.3, 0), (0.33, 0.37, 0.5), 0.3)
    receiver = shapes.receiver(*floor)
    uvs = (0.05 + 0.45 * (receiver.vertices[receiver.corner_vertices][:, :2] + 1)).astype("f4")
    return receiver, uvs, *shapes.join(floor, crate)


def test_no_dark_line_around_what_stands_on_a_floor():
    scene = Bench(*floor_and_crate(), 128)
    found = scene.solve(256, 0.01)
    scene.known = scene.truth()
    errors = scene.errors(scene.image(found.index, found.values))
    assert found.entry["filled_texels"] > 0
    assert found.entry["buried_points"] > 1000
    assert np.quantile(errors, 0.99) < 0.06
    assert errors.max() < 0.2
    assert len(found.index) < len(scene.index)  # the dark below the crate is left to push-pull


def test_a_slit_in_which_no_texel_has_its_centre_is_seen():
    """Between two thin slabs on a floor, three tenths of a texel wide, amid buried texels."""
    size = 16
    left, right = ((column + 0.5) / size / 0.45 - 0.05 / 0.45 - 1 for column in (7.35, 7.65))
    floor = shapes.grid([-1, -1, 0], [2, 0, 0], [0, 2, 0], 1)
    slabs = [
        rooms.block((low, -1.5, -0.01), (high, 1.5, 0.004))
        for low, high in ((-1.5, left), (right, 1.5))
    ]
    receiver = shapes.receiver(*floor)
    uvs = (0.05 + 0.45 * (receiver.vertices[receiver.corner_vertices][:, :2] + 1)).astype("f4")
    scene = Bench(receiver, uvs, *shapes.join(floor, *slabs), size)
    found = scene.solve(256, 0.01)
    scene.known = scene.truth(4000)
    errors = scene.errors(scene.image(found.index, found.values))
    assert len(errors) > 20
    assert rms(errors) < 0.2


def test_no_light_leaks_under_a_partition():
    """At the partition's foot the floor is as dark on the dark side as a little away from it."""
    scene, found = bench("room"), baked("room")
    image = scene.image(found.index, found.values)
    places = scene.receiver.vertices[scene.receiver.triangles].mean(axis=1)
    floor = np.flatnonzero((scene.receiver.normals[::3, 2] > 0.9) & (np.abs(places[:, 2]) < 0.01))
    corners = scene.receiver.vertices[scene.receiver.triangles[floor]][:, :, :2].astype(float)
    uvs = scene.uvs[scene.receiver.triangle_corners[floor]].astype(float)
    flat = np.concatenate([corners.reshape(-1, 2), np.ones((len(floor) * 3, 1))], axis=1)
    to_uv = np.linalg.lstsq(flat, uvs.reshape(-1, 2), rcond=None)[0]
    y = np.linspace(2.2, 3.9, 300)

    def read(x):
        return bilinear(image, np.stack([np.full(300, x), y, np.ones(300)], 1) @ to_uv)[:, 0]

    far_side = rooms.PARTITION + rooms.WALL
    for at in (0.001, 0.01, 0.03):
        assert read(far_side + at).mean() < 1.3 * read(far_side + 0.06).mean() + 1e-4
        assert read(rooms.PARTITION - at).mean() > 0.6 * read(rooms.PARTITION - 0.06).mean()


def test_a_closed_room_stays_dark():
    box = shapes.box(2.0, 2)
    receiver = shapes.receiver(*box)
    found = Bench(receiver, rooms.planar_charts(receiver, 64), *box, 64).solve(64, 0.03)
    assert len(found.index)
    assert not found.values.any()


def edge_of_a_shadow(origins):
    lit = (origins[:, :1] + 0.3 * origins[:, 1:2] > 0.1).astype(np.float32)
    return np.concatenate([lit, lit, lit], axis=1)


def test_a_residual_that_is_seen_is_traced_where_it_changes():
    floor = floor_and_crate()[:2]
    scene = Bench(*floor, np.empty((0, 3)), np.empty((0, 3), np.int32), 128)
    light = np.zeros((1, 9, 3))
    light[0, 0] = 3.5
    smooth = scene.solve(64, 0.01)
    for its_light in (light, None):
        found = scene.solve(64, 0.01, edge_of_a_shadow, its_light)
        assert 1.2 * smooth.entry["traced_texels"] < found.entry["traced_texels"] < 4000
        image = scene.image(found.index, found.values)
        uvs = np.random.default_rng(0).uniform(0.06, 0.94, (4000, 2))
        expected = edge_of_a_shadow((uvs - 0.05) / 0.45 - 1)[:, 0]
        wrong = np.abs(bilinear(image, uvs)[:, 9] - expected) > 0.01
        assert wrong.mean() < 2 * np.sqrt(1.09) / 128 * 1.3  # the texels that the edge crosses
    faint = scene.solve(64, 0.01, lambda o: 1e-4 * edge_of_a_shadow(o), light)
    assert faint.entry["traced_texels"] == smooth.entry["traced_texels"]


def test_reads_across_an_edge_come_nearer_than_means_of_texels(monkeypatch):
    """Where an edge crosses texels their values are those whose reads find it, not their means."""
    scene = Bench(*floor_and_crate()[:2], np.empty((0, 3)), np.empty((0, 3), np.int32), 128)
    uvs = np.random.default_rng(0).uniform(0.06, 0.94, (40000, 2))
    truth = edge_of_a_shadow((uvs - 0.05) / 0.45 - 1)[:, 0]

    def error():
        found = scene.solve(64, 0.01, edge_of_a_shadow)
        shown = bilinear(scene.image(found.index, found.values), uvs)[:, 9]
        assert -1e-3 < shown.min() < shown.max() < 1 + 1e-3  # no bright line along the edge
        return rms(shown - truth)

    fitted = error()
    monkeypatch.setattr(solver, "sharpen", lambda *_: iter(()))
    assert fitted < error()


@pytest.mark.parametrize("count", [1, 2])
def test_the_smallest_meshes(count):
    vertices = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 0.0]])
    receiver = shapes.receiver(vertices, np.array([[0, 1, 2], [1, 3, 2]])[:count])
    uvs = np.array([[0.4, 0.4], [0.44, 0.4], [0.4, 0.44], [0.4, 0.4], [0.4, 0.4], [0.4, 0.4]])
    nothing = np.empty((0, 3)), np.empty((0, 3), np.int32)
    scene = Bench(receiver, uvs[: 3 * count].astype(np.float32), *nothing, 64)
    found = scene.solve(64, 0.03)
    assert 4 <= len(found.index) < 50
    np.testing.assert_allclose(found.values[:, 0], found.values[0, 0], rtol=1e-3)


def test_faces_without_area_have_no_texels():
    receiver = shapes.receiver(np.zeros((3, 3)), np.array([[0, 1, 2]]))
    scene = Bench(receiver, np.random.default_rng(0).random((3, 2)).astype(np.float32),
                  np.empty((0, 3)), np.empty((0, 3), np.int32), 64)  # fmt: skip
    assert not len(scene.solve(64, 0.03).index)
    assert not len(pilot_points(receiver).origins)


def test_what_was_traced_is_known():
    scene, found = bench("torus"), baked("torus")
    record = found.traced
    assert (record.point == -1).all()
    np.testing.assert_allclose(record.noisier, (256 / record.rays) ** traced.FALL)
    again = scene.found(record.origins, record.normals, 2048)
    assert rms(again - record.values) < 0.05 * rms(again)


def test_pilot_points_lie_on_the_surface():
    receiver, *_ = rooms.torus()
    points = pilot_points(receiver, 500)
    assert len(points.origins) == 500
    ring = np.linalg.norm(points.origins[:, :2], axis=1) - 1
    assert np.hypot(ring, points.origins[:, 2]) == pytest.approx(0.45, abs=0.02)
