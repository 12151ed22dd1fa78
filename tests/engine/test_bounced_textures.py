"""Light that bounces, in textures: the rays of a texel gather what leaves the surfaces about it."""

from dataclasses import replace
from functools import partial

import numpy as np
import pytest
import shapes
from prt_baker.addon.prt import bounced, place_tape
from prt_baker.addon.prt import job as jobs
from prt_baker.addon.prt.bands import exit_radiance
from prt_baker.addon.prt.light.projection import world_sh
from prt_baker.addon.prt.run import run
from prt_baker.addon.prt.texture.places import pilot_points
from prt_baker.addon.prt.texturing import between_texels
from test_baking import sky
from test_bounces import WHITE, baked, bowl_job, job_of, rays_of, relative_rms, room, well_job
from test_run import finish

__all__ = ["room"]  # a fixture
SIZE = 128


def in_textures(job, resolution=SIZE, **settings):
    receivers = tuple(replace(one, carrier="texture") for one in job.receivers)
    chosen = replace(job.settings, resolution=resolution, padding_mip=0, **settings)
    return replace(job, receivers=receivers, settings=chosen)


def shown(job, result, count=2000):
    """The transfer (count, channels, n²) that a texture shows at random places."""
    return between_texels(job.receivers[0], result, job.settings.resolution, count, 1).transfer


@pytest.mark.parametrize("albedo", [0.8, [0.9, 0.5, 0.1]])
def test_a_spherical_bowl_is_as_its_closed_form(albedo):
    covered = 0.6
    (direct,) = baked(in_textures(bowl_job(covered, 0.5))).receivers
    for bounces in (1, 3, 20):
        job = in_textures(bowl_job(covered, albedo, bounces=bounces))
        (result,) = baked(job).receivers
        plain = shown(job, direct)[:, 0]
        found = shown(job, result)
        channels = np.atleast_1d(albedo)
        assert found.shape[1] == len(channels)
        for channel, its in enumerate(channels):
            whole = its * covered
            truth = plain + whole * sum(whole**k for k in range(bounces)) * plain.mean(axis=0)
            assert relative_rms(found[:, channel], truth) < 0.01


def test_a_white_furnace_fills_up_and_never_overflows():
    before = 0.0
    for bounces in (0, 1, 2, 5, jobs.ALL):
        job = in_textures(bowl_job(0.7, 1.0, bounces=bounces))
        (result,) = baked(job).receivers
        white = result.transfer[:, 0, 0] * WHITE
        assert white.max() < 1 + 1e-4
        assert white.mean() > before
        before = white.mean()
    assert before == pytest.approx(1, abs=5e-3)


def test_what_nobody_met_before_the_texels_sends_light_back_too(monkeypatch):
    """Forty places miss many of the bowl's cells: those beside what they met count."""
    monkeypatch.setattr(bounced, "pilot_points", partial(pilot_points, count=40))
    covered, albedo = 0.7, 0.8
    (direct,) = baked(in_textures(bowl_job(covered, albedo))).receivers
    job = in_textures(bowl_job(covered, albedo, bounces=1))
    (result,) = baked(job).receivers
    plain = shown(job, direct)[:, 0]
    truth = plain + albedo * covered * plain.mean(axis=0)
    assert relative_rms(shown(job, result)[:, 0], truth) < 0.02


def test_the_light_of_a_well_is_that_of_random_walks():
    job = well_job(0, 0.7, 10, bounces=3, verify_points=100, verify_rays=8192)
    (entry,) = baked(in_textures(job)).report["objects"]
    assert entry["measured_error"]["on_surface"] < 0.03


def test_at_the_baked_world_both_carriers_show_the_same(room):
    settings = replace(room.settings, rays=512, cache="")
    on_vertices = replace(room, settings=settings)
    textured = in_textures(on_vertices, 256)
    results = baked(textured)
    light = world_sh(results.image_sh, (1, 1, 1), np.eye(3))[:9]
    vertices = baked(on_vertices).receivers[0]
    result, body = results.receivers[0], room.receivers[0]
    corners = (result.in_atlas.uvs[body.triangle_corners] * 256).mean(axis=1).astype(int)
    rows = np.full(256 * 256, -1)
    rows[result.in_atlas.texels] = np.arange(len(result.in_atlas.texels))
    rows = rows[corners[:, 1] * 256 + corners[:, 0]]
    assert (rows >= 0).all()
    of_texels = exit_radiance(result.transfer, light) + result.residual[:, 0]
    of_vertices = exit_radiance(vertices.transfer, light) + vertices.residual[:, 0]
    elements = vertices.element_points[body.triangle_corners]
    middle = of_vertices[elements].mean(axis=1)
    direct = baked(replace(textured, settings=replace(textured.settings, bounces=0)))
    alone = direct.receivers[0]
    alone = exit_radiance(alone.transfer, light) + alone.residual[:, 0]
    missed = relative_rms(of_texels[rows], middle)
    assert missed < 0.1
    assert relative_rms(alone[rows], middle) > 2 * missed


def test_what_is_not_baked_passes_light_on(room):
    """The ball alone, in the coloured box: it is lit from there as when that is baked too."""
    whole = replace(room, settings=replace(room.settings, cache="", residual=False))
    ball = replace(whole, receivers=whole.receivers[1:])
    expected, found = baked(in_textures(whole)), baked(in_textures(ball))
    middle = expected.receivers[1].transfer.mean(axis=0)
    np.testing.assert_allclose(found.receivers[0].transfer.mean(axis=0), middle, atol=0.01)
    assert found.report["objects"][0]["unbaked_places"] > 0


def test_an_unchanged_scene_costs_no_ray_and_another_albedo_is_another_result(room):
    job = in_textures(room, 64)
    first, second = baked(job), baked(job)
    assert min(rays_of(first)) > 0
    assert rays_of(second) == [0, 0]
    other = replace(job, occluder_albedo=job.occluder_albedo[..., ::-1].copy())
    redder = baked(other)
    fresh = baked(uncached(other))
    for a, b, c in zip(first.receivers, second.receivers, redder.receivers, strict=True):
        np.testing.assert_array_equal(a.transfer, b.transfer)
        assert np.abs(a.transfer - c.transfer).max() > 0.01
    for found, expected in zip(redder.receivers, fresh.receivers, strict=True):
        np.testing.assert_array_equal(found.transfer, expected.transfer)
    assert max(to_the_sky(redder)) < 0.05 * min(to_the_sky(fresh))


def uncached(job):
    return replace(job, settings=replace(job.settings, cache=""))


def to_the_sky(results):
    return [entry["rays"] - entry["map_rays"] for entry in results.report["objects"]]


def test_another_light_traces_no_texel_again(room):
    """Only where it shades texels that no other had traced: twice as bright it shades none, and
    another sun few.  What comes out is what comes out without a cache."""
    job = in_textures(room, 96)
    first = baked(job)
    brighter = baked(replace(job, light=replace(job.light, strength=2.0)))
    assert to_the_sky(brighter) == [0, 0]
    other = replace(job, light=jobs.LightSource(pixels=sky(1)))
    (steps, found), fresh = finish(run(other)), baked(uncached(other))
    assert [step.fraction for step in steps] == sorted(step.fraction for step in steps)
    for a, b, c in zip(found.receivers, fresh.receivers, first.receivers, strict=True):
        np.testing.assert_array_equal(a.transfer, b.transfer)
        np.testing.assert_array_equal(a.residual, b.residual)
        assert relative_rms(c.residual, a.residual) > 0.1
    for its, all_of in zip(to_the_sky(found), to_the_sky(fresh), strict=True):
        assert its < 0.2 * all_of
    unbaked = [results.report["objects"][0]["unbaked_rays"] for results in (found, fresh)]
    assert unbaked[0] < 0.8 * unbaked[1]
    brighter = baked(replace(other, light=replace(other.light, strength=2.0)))
    assert to_the_sky(brighter) == [0, 0]


def test_what_finds_no_room_is_traced_again(room, monkeypatch):
    job = in_textures(room, 64)
    expected = baked(uncached(job))
    monkeypatch.setattr(place_tape, "LARGEST", 1 << 16)
    first = baked(job)
    second = baked(replace(job, light=replace(job.light, strength=2.0)))
    assert to_the_sky(second) == to_the_sky(first)
    for a, b in zip(first.receivers, expected.receivers, strict=True):
        np.testing.assert_array_equal(a.transfer, b.transfer)


def test_vertices_and_textures_mix(room):
    settings = replace(room.settings, cache="", residual=False, resolution=64)
    box, ball = room.receivers
    mixed = replace(room, settings=settings, receivers=(box, replace(ball, carrier="texture")))
    results = baked(mixed)
    alone = baked(replace(room, settings=settings, receivers=(box,)))
    assert results.receivers[0].in_atlas is None
    assert results.receivers[1].in_atlas is not None
    np.testing.assert_array_equal(results.receivers[0].transfer, alone.receivers[0].transfer)
    assert [result.transfer.shape[1] for result in results.receivers] == [3, 3]


def test_under_an_open_sky_nothing_bounces():
    vertices, triangles = shapes.grid([0, 0, 0], [1, 0, 0], [0, 1, 0], 2)
    floor = replace(shapes.receiver(vertices, triangles), vertices=vertices)
    job = in_textures(job_of((floor,), vertices, triangles, 0.8, bounces=2), 32)
    plain = replace(job, settings=replace(job.settings, bounces=0))
    (found,), (expected,) = baked(job).receivers, baked(plain).receivers
    np.testing.assert_allclose(found.transfer, expected.transfer, atol=1e-6)
