"""Direct light that is kept beside the whole, so that a viewer can leave out what bounces add."""

from dataclasses import replace

import numpy as np
import pytest
from prt_baker.addon.prt import job as jobs
from prt_baker.addon.prt.bands import exit_radiance
from prt_baker.addon.prt.files.atlases import read_tiles
from prt_baker.addon.prt.light.projection import world_sh
from prt_baker.addon.prt.results import read_results, write_results
from test_bounced_textures import in_textures
from test_bounces import WHITE, baked, bowl_job, rays_of, relative_rms, room

__all__ = ["room"]  # a fixture
ARRAYS = ("transfer", "residual", "visibility", "visibility_sh", "element_points")


def with_settings(job, **settings):
    return replace(job, settings=replace(job.settings, **settings))


@pytest.fixture(params=["vertices", "textures", "both"])
def scene(room, request):
    """The room without a cache, on a carrier, with a sun cut out and what is seen."""
    job = with_settings(room, cache="", peaks=1, visibility_order=2)
    if request.param == "vertices":
        return job
    job = in_textures(job, 64)
    if request.param == "textures":
        return job
    return replace(job, receivers=(replace(job.receivers[0], carrier="vertex"), job.receivers[1]))


def test_it_costs_no_ray_and_leaves_the_whole_as_it_is(scene):
    plain, kept = baked(scene), baked(with_settings(scene, keep_direct=True))
    assert rays_of(kept) == rays_of(plain)
    assert min(rays_of(kept)) > 0
    for entries in zip(plain.report["objects"], kept.report["objects"], strict=True):
        assert entries[0].get("unbaked_rays") == entries[1].get("unbaked_rays")
    for before, after in zip(plain.receivers, kept.receivers, strict=True):
        for name in ARRAYS:
            np.testing.assert_array_equal(getattr(after, name), getattr(before, name))
        assert before.direct is None
        assert after.direct.transfer.shape == (len(after.transfer), 1, 9)
        assert after.direct.residual.shape == after.residual.shape
        np.testing.assert_array_equal(after.direct.visibility, after.visibility)
    for before, after in zip(plain.atlases, kept.atlases, strict=True):
        np.testing.assert_array_equal(after.image, before.image)
        assert before.direct is None


@pytest.mark.parametrize("carrier", ["vertex", "texture"])
def test_it_is_what_a_bake_without_bounces_makes(room, carrier):
    """In a texture other texels are traced, as the light that bounces is looked at too."""
    job = with_settings(room, cache="", rays=512, keep_direct=True)
    job = in_textures(job, 64) if carrier == "texture" else job
    for whole, direct in zip(
        baked(job).receivers, baked(with_settings(job, bounces=0)).receivers, strict=True
    ):
        assert direct.direct is None
        rows = slice(None), slice(None)
        if carrier == "texture":
            texels = whole.in_atlas.texels, direct.in_atlas.texels
            _, *rows = np.intersect1d(*texels, return_indices=True)
            assert len(rows[0]) > 0.99 * len(texels[0])
        for name in ("transfer", "residual"):
            kept, alone = (
                getattr(result, name)[its]
                for result, its in zip((whole.direct, direct), rows, strict=True)
            )
            if carrier == "vertex":
                np.testing.assert_array_equal(kept, alone)
            else:
                assert relative_rms(kept, alone) < 0.1
        added = relative_rms(whole.transfer.mean(axis=1), whole.direct.transfer[:, 0])
        assert added > 0.2


def test_what_bounces_add_is_the_closed_form_of_a_bowl():
    """A point of a spherical bowl meets all others alike: the same is added everywhere."""
    (result,) = baked(bowl_job(0.6, 0.8, bounces=3, keep_direct=True)).receivers
    direct = result.direct.transfer[:, 0, 0] * WHITE
    added = result.transfer[:, 0, 0] * WHITE - direct
    whole = 0.6 * 0.8
    assert added.mean() == pytest.approx(sum(whole**k for k in (1, 2, 3)) * direct.mean(), rel=0.01)
    assert added.std() < 0.01 * added.mean()


def test_where_nothing_is_reflected_both_are_the_same():
    (result,) = baked(bowl_job(0.6, 0.0, bounces=3, keep_direct=True)).receivers
    np.testing.assert_array_equal(result.direct.transfer, result.transfer)


def test_bands_that_are_left_out_go_into_its_residual(room):
    """Under a final light order 1 is stored; what leaves the surface is the same."""
    job = with_settings(room, cache="", keep_direct=True)
    results, short = baked(job), baked(with_settings(job, final_light=True))
    light = world_sh(results.image_sh, (1, 1, 1), np.eye(3))
    for whole, less in zip(results.receivers, short.receivers, strict=True):
        assert less.direct.transfer.shape[2] == less.transfer.shape[2] == 1
        shown = [
            exit_radiance(its.transfer, light[: its.transfer.shape[2]]) + its.residual[:, 0]
            for its in (whole.direct, less.direct)
        ]
        np.testing.assert_allclose(shown[1], shown[0], atol=1e-4)


@pytest.mark.parametrize("carrier", ["vertex", "texture"])
def test_it_is_kept_in_the_cache(room, carrier):
    job = with_settings(room, keep_direct=True)
    job = in_textures(job, 64) if carrier == "texture" else job
    first, second = baked(job), baked(job)
    assert min(rays_of(first)) > 0
    assert rays_of(second) == [0, 0]
    for before, after in zip(first.receivers, second.receivers, strict=True):
        np.testing.assert_array_equal(after.direct.transfer, before.direct.transfer)
        np.testing.assert_array_equal(after.direct.residual, before.direct.residual)


def test_switched_on_later_only_the_map_is_looked_at(room):
    baked(room)
    for entry in baked(with_settings(room, keep_direct=True)).report["objects"]:
        assert entry["rays"] == entry["map_rays"] > 0


def test_results_are_read_as_they_were_written(scene, tmp_path):
    results = baked(with_settings(scene, keep_direct=True))
    write_results(results, tmp_path)
    read = read_results(tmp_path)
    for before, after in zip(results.receivers, read.receivers, strict=True):
        assert after.direct is not None
        if before.in_atlas is None:
            np.testing.assert_array_equal(after.direct.transfer, before.direct.transfer)
            np.testing.assert_array_equal(after.direct.residual, before.direct.residual)
    for before, after in zip(results.atlases, read.atlases, strict=True):
        image, names = read_tiles(after.direct.path)
        assert names == after.direct.names == before.direct.names
        assert names[:2] == ("T0", "T1")
        np.testing.assert_array_equal(image, before.direct.image)
        assert after.direct.size == after.size


def test_images_for_engines_are_there_of_both(room, tmp_path):
    job = with_settings(in_textures(room, 64), cache="", keep_direct=True, engine_images="png")
    write_results(baked(job), tmp_path)
    (atlas,) = read_results(tmp_path).atlases
    names = [[file.name for file in one.files] for one in (atlas, atlas.direct)]
    assert names[1] == ["direct_0.json", "direct_0_0.png", "direct_0_1.png", "direct_0_2.png"]
    assert all(name.startswith("atlas_0") for name in names[0])


def test_it_names_another_result():
    plain = bowl_job(0.6, 0.8, bounces=1)
    kept = with_settings(plain, keep_direct=True)
    assert jobs.content_hash(plain) != jobs.content_hash(kept)
