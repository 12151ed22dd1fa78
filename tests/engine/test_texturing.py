"""Whole bakes into atlases: what is kept, what is shown, who shares one, and what is chosen."""

from dataclasses import replace

import numpy as np
import pytest
import shapes
from prt_baker.addon import engine
from prt_baker.addon.prt import choosing, texturing
from prt_baker.addon.prt import job as jobs
from prt_baker.addon.prt.errors import BakeError
from prt_baker.addon.prt.files.atlases import read_tiles
from prt_baker.addon.prt.run import run
from prt_baker.addon.prt.texture.sampling import bilinear
from test_baking import rays_of, same, sky
from test_run import finish

SIZE = 64


@pytest.fixture
def job(tmp_path):
    """A ball over a floor of two triangles, which share an atlas."""
    ball, faces, normals = shapes.sphere(8, 16)
    floor = shapes.grid([-3, -3, -1.2], [6, 0, 0], [0, 6, 0], 1)
    vertices, triangles = shapes.join((ball, faces), floor)
    body = replace(shapes.receiver(ball, faces, normals, "ball"), vertices=ball)
    ground = replace(shapes.receiver(*floor, name="floor"), vertices=floor[0])
    settings = jobs.Settings(rays=48, resolution=SIZE, cache=str(tmp_path / "cache"))
    return jobs.Job(
        settings=settings,
        light=jobs.LightSource(pixels=sky(0)),
        receivers=tuple(replace(one, carrier="texture") for one in (body, ground)),
        occluder_vertices=vertices,
        occluder_triangles=triangles,
        occluder_starts=np.array([0, len(faces), len(triangles)]),
    )


def with_settings(job, **changes):
    return replace(job, settings=replace(job.settings, **changes))


def test_the_file_shows_what_was_baked(job, tmp_path):
    """Every texel of the file is the receiver's, or filled; nothing is left empty.  (The fit along
    borders may take a texel beside the ball's poles, of which next to nothing is read, to 0.)"""
    steps, results = finish(engine.run(job, tmp_path))
    fractions = [step.fraction for step in steps]
    assert fractions == sorted(fractions)
    assert {"unwrap", "transfer", "write"} <= {step.phase for step in steps}
    [atlas] = results.atlases
    image, names = read_tiles(atlas.path)
    assert names == atlas.names == tuple([f"T{i}" for i in range(9)] + ["R0r", "R0g", "R0b"])
    assert image.shape == (SIZE, SIZE, 12)
    assert (image[..., 0] <= 0).sum() <= 2
    for result, receiver in zip(results.receivers, job.receivers, strict=True):
        uvs = result.in_atlas.uvs
        assert uvs.shape == (len(receiver.corner_vertices), 2)
        assert 0 <= uvs.min() <= uvs.max() <= 1
        shown = bilinear(image, uvs[receiver.triangle_corners].mean(axis=1))
        assert np.isfinite(shown).all()
        size = np.sqrt((result.transfer**2).mean())
        assert 0.8 < np.sqrt((shown[:, :9] ** 2).mean()) / size < 1.2


def test_an_unchanged_scene_costs_no_ray_and_gives_the_same_file(job):
    _, first = finish(run(job))
    _, second = finish(run(job))
    assert min(rays_of(first)) > 0
    assert rays_of(second) == [0, 0]
    np.testing.assert_array_equal(first.atlases[0].image, second.atlases[0].image)


def test_an_object_that_is_moved_leaves_the_other_its_place(job):
    """The UVs of an earlier bake are used again, so that the floor is not traced anew."""
    lifted = replace(job.receivers[0], vertices=job.receivers[0].vertices + np.array([0, 0, 5.0]))
    alone = replace(
        job,
        occluder_vertices=job.occluder_vertices[:0],
        occluder_triangles=job.occluder_triangles[:0],
        occluder_starts=np.array([0]),
    )
    _, first = finish(run(alone))
    entry = first.report["objects"][0]
    kept = [
        replace(receiver, uvs=result.in_atlas.uvs, uv_key=entry["uv_key"])
        for receiver, result in zip((lifted, job.receivers[1]), first.receivers, strict=True)
    ]
    _, second = finish(run(replace(alone, receivers=tuple(kept))))
    assert rays_of(second)[0] > 0
    assert rays_of(second)[1] == 0
    for before, after in zip(first.receivers, second.receivers, strict=True):
        np.testing.assert_array_equal(before.in_atlas.uvs, after.in_atlas.uvs)


def test_a_key_of_another_size_is_unwrapped_anew(job):
    _, first = finish(run(job))
    entry = first.report["objects"][0]
    kept = [
        replace(receiver, uvs=result.in_atlas.uvs, uv_key=entry["uv_key"])
        for receiver, result in zip(job.receivers, first.receivers, strict=True)
    ]
    larger = with_settings(replace(job, receivers=tuple(kept)), resolution=2 * SIZE)
    _, second = finish(run(larger))
    assert second.atlases[0].size == 2 * SIZE
    assert (first.receivers[0].in_atlas.uvs != second.receivers[0].in_atlas.uvs).any()


def test_who_shares_an_atlas(job):
    def members(*groups, shared=False):
        receivers = [replace(job.receivers[0], group=group) for group in groups]
        its = with_settings(replace(job, receivers=tuple(receivers)), shared_atlas=shared)
        found = texturing.plans(its, range(len(groups)))
        return sorted(plan.receivers for plan in found)

    assert members(0, 1, 0, -1, -1) == [(0, 2), (1,), (3,), (4,)]
    assert members(0, 1, 0, -1, -1, shared=True) == [(0, 1, 2, 3, 4)]


def own_square(receiver):
    """``receiver``, a square of two triangles, with a UV map over nearly the whole of the atlas."""
    places = np.asarray(receiver.vertices)[receiver.corner_vertices, :2]
    low, high = places.min(axis=0), places.max(axis=0)
    uvs = 0.05 + 0.9 * (places - low) / (high - low)
    return replace(receiver, uvs=uvs.astype(np.float32))


def test_a_map_of_the_artists_is_used_and_has_an_atlas_of_its_own(job):
    own = own_square(job.receivers[1])
    _, results = finish(run(replace(job, receivers=(job.receivers[0], own))))
    np.testing.assert_array_equal(results.receivers[1].in_atlas.uvs, own.uvs)
    assert {result.in_atlas.atlas for result in results.receivers} == {0, 1}
    assert [entry["own_uvs"] for entry in results.report["objects"]] == [False, True]


@pytest.mark.parametrize(
    ("spoil", "words"),
    [
        (lambda uvs: uvs * 0, "no area"),
        (lambda uvs: uvs + 0.5, "outside"),
        (lambda uvs: np.where(np.arange(6)[:, None] < 3, uvs, uvs[[0, 1, 2] * 2]), "over itself"),
    ],
)
def test_a_map_of_the_artists_that_cannot_be_used_is_one_sentence(job, spoil, words):
    own = own_square(job.receivers[1])
    bad = replace(own, uvs=np.ascontiguousarray(spoil(own.uvs), np.float32))
    with pytest.raises(BakeError, match=f"{words}.*rename the map"):
        finish(run(replace(job, receivers=(bad,))))


def test_a_material_of_two_maps_of_which_one_is_the_artists_is_one_sentence(job):
    own = replace(own_square(job.receivers[1]), group=3)
    with pytest.raises(BakeError, match="'floor' has a UV map PRT of its own and shares"):
        finish(run(replace(job, receivers=(replace(job.receivers[0], group=3), own))))


def test_a_density_gives_the_power_of_two_that_holds_it(job):
    dense = with_settings(replace(job, receivers=job.receivers[1:]), texel_density=20.0)
    _, results = finish(run(dense))
    [result] = results.receivers
    [atlas] = results.atlases
    corners = result.in_atlas.uvs[job.receivers[1].triangle_corners] * atlas.size
    side = np.linalg.norm(corners[:, 1] - corners[:, 0], axis=1).max()
    assert atlas.size & (atlas.size - 1) == 0
    assert side >= 6 * 20.0 * 0.99


def test_verify_measures_what_is_between_texels(job):
    its = with_settings(job, verify_points=100, verify_rays=4096)
    _, results = finish(run(its))
    for entry in results.report["objects"]:
        measured = entry["measured_error"]
        assert 0 < measured["on_surface"] < 0.06
        assert measured["light_on_surface"] < 0.06
        assert measured["on_surface"] < 2 * entry["surface_error"] + 0.01


def test_vertices_and_textures_mix(job):
    mixed = (replace(job.receivers[0], carrier="vertex"), job.receivers[1])
    _, results = finish(run(replace(job, receivers=mixed)))
    ball, floor = results.receivers
    assert ball.in_atlas is None
    assert len(ball.element_points) == len(job.receivers[0].normals)
    assert floor.in_atlas.atlas == 0
    assert results.report["objects"][1]["carrier"] == "texture"


class TestAuto:
    def open_job(self, job, **changes):
        receivers = tuple(replace(one, carrier="auto") for one in job.receivers)
        return with_settings(replace(job, receivers=receivers), **changes)

    def test_a_floor_of_two_triangles_takes_a_texture(self, job):
        _, results = finish(run(self.open_job(job)))
        ball, floor = results.report["objects"]
        assert floor["carrier"] == "texture"
        assert floor["predicted"]["vertex_error"] > 0.05 > floor["predicted"]["texture_error"]
        assert ball["predicted"]["vertex_error"] < floor["predicted"]["vertex_error"]

    def test_a_fine_mesh_stays_on_its_vertices(self, job):
        fine = shapes.grid([-3, -3, -1.2], [6, 0, 0], [0, 6, 0], 60)
        up = np.tile([0.0, 0.0, 1.0], (len(fine[0]), 1))
        ground = replace(shapes.receiver(*fine, up, "floor"), vertices=fine[0], carrier="auto")
        _, results = finish(run(replace(job, receivers=(ground,))))
        assert results.receivers[0].in_atlas is None

    def test_what_shares_a_material_is_decided_together(self, job):
        grouped = tuple(replace(one, carrier="auto", group=0) for one in job.receivers)
        _, results = finish(run(replace(job, receivers=grouped)))
        carriers = {result.in_atlas is None for result in results.receivers}
        assert len(carriers) == 1

    def test_light_that_bounces_changes_no_carrier(self, job):
        albedo = np.full((len(job.occluder_triangles), 3, 3), 0.5, np.float32)
        its = self.open_job(replace(job, occluder_albedo=albedo), bounces=1)
        (_, bounced), (_, plain) = finish(run(its)), finish(run(self.open_job(job)))
        found, expected = (
            [result.in_atlas is None for result in results.receivers]
            for results in (bounced, plain)
        )
        assert found == expected

    def test_the_second_time_it_costs_no_ray(self, job):
        _, first = finish(run(self.open_job(job)))
        _, second = finish(run(self.open_job(job)))
        assert rays_of(second) == [0, 0]
        assert [e["predicted"] for e in first.report["objects"]] == [
            e["predicted"] for e in second.report["objects"]
        ]

    @pytest.mark.parametrize(
        ("errors", "sizes", "expected"),
        [
            ((0.01, 0.005), (1, 9), "vertex"),
            ((0.01, 0.005), (9, 1), "texture"),
            ((0.1, 0.01), (1, 9), "texture"),
            ((0.2, 0.3), (9, 1), "vertex"),
        ],
    )
    def test_the_rule(self, errors, sizes, expected):
        assert choosing.Choice(*errors, *sizes).carrier(0.02) == expected


def under(job, seed, *, cached=True):
    """``job`` in a finer atlas, under the sky of this ``seed``."""
    job = with_settings(job, resolution=192, cache=job.settings.cache if cached else "")
    return replace(job, light=jobs.LightSource(pixels=sky(seed)))


def without_map_rays(results):
    return [entry["rays"] - entry["map_rays"] for entry in results.report["objects"]]


def test_another_light_traces_no_texel_again(job):
    """The shadow of another sun has texels of its own; all others are known, and what comes out is
    what comes out without a cache.  Under a third light, whose sun stands where the first one's
    does, all are."""
    _, first = finish(run(under(job, 0)))
    _, second = finish(run(under(job, 1)))
    _, fresh = finish(run(under(job, 1, cached=False)))
    (ball, floor), all_of = without_map_rays(second), without_map_rays(fresh)
    assert ball == 0
    assert floor < 0.05 * all_of[1]
    same(second, fresh)
    stronger = under(job, 0)
    stronger = replace(stronger, light=replace(stronger.light, strength=2.0))
    _, third = finish(run(stronger))
    assert without_map_rays(third) == [0, 0]
    assert min(without_map_rays(first)) > 0
