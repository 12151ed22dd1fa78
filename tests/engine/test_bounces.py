"""Light that bounces, against what is known of it in closed form."""

from dataclasses import replace

import numpy as np
import pytest
import shapes
from prt_baker.addon.prt import job as jobs
from prt_baker.addon.prt.bands import exit_radiance
from prt_baker.addon.prt.bounces import hits
from prt_baker.addon.prt.bounces.walks import Walls
from prt_baker.addon.prt.light import lat_long
from prt_baker.addon.prt.light.projection import world_sh
from prt_baker.addon.prt.run import run
from prt_baker.addon.prt.surface.points import distinct_points
from prt_baker.addon.prt.tracing import rays, transfer
from prt_baker.addon.prt.tracing.hemisphere import cosine_fibonacci, frames
from test_baking import sky
from test_run import finish

WHITE = np.sqrt(4 * np.pi)  # the coefficient of a sky of radiance 1


def bowl(covered, rows=48, columns=96):
    """A sphere of radius 1 seen from inside, of whose area the share ``covered`` is there, open at
    the top: vertices, triangles, normals.  Its rings have equal areas."""
    z = np.linspace(-1, 2 * covered - 1, rows + 1)[1:]
    phi = 2 * np.pi * np.arange(columns) / columns
    radius = np.sqrt(np.maximum(0, 1 - z**2))[:, None]
    rings = np.stack([radius * np.cos(phi), radius * np.sin(phi), z[:, None] + 0 * phi], axis=-1)
    vertices = np.concatenate([[[0, 0, -1]], rings.reshape(-1, 3)])
    i, j = np.meshgrid(np.arange(rows - 1), np.arange(columns), indexing="ij")
    a, b = 1 + i * columns + j, 1 + i * columns + (j + 1) % columns
    c, d = a + columns, b + columns
    a, b, c, d = (x.reshape(-1) for x in (a, b, c, d))
    around = np.arange(columns)
    pole = np.stack([0 * around, 1 + (around + 1) % columns, 1 + around], axis=1)
    sides = np.concatenate([np.stack([a, d, c], 1), np.stack([a, b, d], 1)])
    triangles = np.concatenate([pole, sides])
    corners = vertices[triangles]
    facing = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    inward = (facing * corners.mean(axis=1)).sum(axis=1) < 0
    triangles[~inward] = triangles[~inward][:, ::-1]
    return vertices, triangles.astype(np.int32), -vertices


def job_of(receivers, vertices, triangles, albedo, **settings):
    """A job in which everything has one ``albedo``, or each triangle its own."""
    of_corners = np.broadcast_to(np.asarray(albedo, np.float32), (len(triangles), 3, 3))
    chosen = jobs.Settings(**{"rays": 256, "residual": False, **settings})
    light = jobs.LightSource()
    return jobs.Job(
        "bake", chosen, light, receivers, vertices, triangles, occluder_albedo=of_corners.copy()
    )


def baked(job):
    _, results = finish(run(job))
    return results


def bowl_job(covered, albedo, **settings):
    vertices, triangles, normals = bowl(covered)
    body = replace(shapes.receiver(vertices, triangles, normals), vertices=vertices)
    return job_of((body,), vertices, triangles, albedo, **settings)


def well(count):
    """An open-topped box of side 1 about the origin, five faces seen from inside."""
    sides = [shapes.grid([-0.5, -0.5, -0.5], [1, 0, 0], [0, 1, 0], count)]
    for origin, u in (
        ([-0.5, -0.5, -0.5], [0, 1, 0]),
        ([-0.5, 0.5, -0.5], [1, 0, 0]),
        ([0.5, 0.5, -0.5], [0, -1, 0]),
        ([0.5, -0.5, -0.5], [-1, 0, 0]),
    ):
        sides.append(shapes.grid(origin, u, [0, 0, 1], count))
    return shapes.join(*sides)


def relative_rms(values, truth):
    return float(np.sqrt(((values - truth) ** 2).mean() / (truth**2).mean()))


def areas_of(receiver):
    corners = np.asarray(receiver.vertices, float)[receiver.triangles]
    cross = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    return 0.5 * np.linalg.norm(cross, axis=1)


def in_closed_form(receiver, direct, albedo, bounces):
    """Transfer (P, n²) in a spherical bowl, every point of which sees every other one alike:
    T_K = T_0 + rho f sum (rho f)^k mean(T_0), f being the share of the sphere that is there."""
    areas = areas_of(receiver)
    transfer = direct.transfer[:, 0].astype(float)
    points = direct.element_points[receiver.triangles]
    weights = np.bincount(points.reshape(-1), np.repeat(areas / 3, 3), len(transfer))
    mean = weights @ transfer / weights.sum()
    whole = albedo * areas.sum() / (4 * np.pi)
    return transfer + whole * sum(whole**k for k in range(bounces)) * mean


@pytest.mark.parametrize("covered", [0.5, 0.75])
@pytest.mark.parametrize("fit", [True, False])
def test_a_spherical_bowl_is_as_its_closed_form(covered, fit):
    (direct,) = baked(bowl_job(covered, 0.8, fit=fit)).receivers
    for bounces in (1, 3, 20):
        job = bowl_job(covered, 0.8, fit=fit, bounces=bounces)
        (result,) = baked(job).receivers
        truth = in_closed_form(job.receivers[0], direct, 0.8, bounces)
        assert result.transfer.shape[1] == 1
        assert relative_rms(result.transfer[:, 0], truth) < 0.005


def test_each_channel_has_its_own_albedo():
    albedo = np.array([0.9, 0.5, 0.1])
    (direct,) = baked(bowl_job(0.6, 0.5)).receivers
    job = bowl_job(0.6, albedo, bounces=3)
    (result,) = baked(job).receivers
    assert result.transfer.shape[1] == 3
    for channel, its in enumerate(albedo):
        truth = in_closed_form(job.receivers[0], direct, its, 3)
        assert relative_rms(result.transfer[:, channel], truth) < 0.005


def test_a_white_furnace_fills_up_and_never_overflows():
    """Albedo 1 under a white sky: after K bounces all but f^(K+1) of it is there."""
    for make in (bowl_job, well_job):
        before = 0.0
        for bounces in (0, 1, 2, 5):
            (result,) = baked(make(0.7, 1.0, bounces=bounces)).receivers
            white = result.transfer[:, 0, 0] * WHITE
            assert white.max() < 1 + 1e-4
            assert np.all(white > before - 1e-4)
            before = white
            if make is bowl_job:
                whole = areas_of(make(0.7, 1.0).receivers[0]).sum() / (4 * np.pi)
                mean = np.average(white)
                assert mean == pytest.approx(1 - whole ** (bounces + 1), abs=2e-3)


def test_a_furnace_that_goes_on_is_white():
    (result,) = baked(bowl_job(0.7, 1.0, bounces=jobs.ALL)).receivers
    assert np.abs(result.transfer[:, 0, 0] * WHITE - 1).max() < 2e-3


def well_job(_, albedo, count=10, **settings):
    vertices, triangles = well(count)
    body = replace(shapes.receiver(vertices, triangles), vertices=vertices)
    return job_of((body,), vertices, triangles, albedo, **settings)


@pytest.mark.parametrize("count", [10, 20])
def test_the_light_of_a_well_is_that_of_random_walks(count):
    """Its vertices lie on concave edges, which is where bounced bakes go wrong."""
    job = well_job(0, 0.7, count, bounces=3, verify_points=100, verify_rays=8192)
    (entry,) = baked(job).report["objects"]
    assert entry["measured_error"]["on_surface"] < 0.025


def test_what_does_not_fit_into_memory_is_traced_again(monkeypatch):
    job = bowl_job(0.6, [0.8, 0.5, 0.2], bounces=3, rays=64)
    kept = baked(job)
    monkeypatch.setattr(hits.Budget.__init__, "__defaults__", (50_000,))
    again = baked(job)
    np.testing.assert_allclose(
        again.receivers[0].transfer, kept.receivers[0].transfer, rtol=1e-4, atol=1e-6
    )


@pytest.mark.parametrize("threads", [1, 3])
def test_threads_change_nothing(threads):
    job = well_job(0, [0.8, 0.5, 0.2], bounces=2, rays=64)
    one, many = (
        baked(replace(job, settings=replace(job.settings, threads=n))) for n in (2, threads)
    )
    np.testing.assert_array_equal(one.receivers[0].transfer, many.receivers[0].transfer)


def halves(job):
    """``job`` with the first half of its triangles for the receiver; all of them stop light."""
    (body,) = job.receivers
    first = len(body.triangles) // 2
    fewer = replace(
        body, triangles=body.triangles[:first], triangle_corners=body.triangle_corners[:first]
    )
    return replace(job, receivers=(fewer,))


@pytest.mark.parametrize("bounces", [1, 4])
def test_what_is_not_baked_passes_light_on(bounces):
    """Half of a bowl baked, the other half a thing that stands by."""
    plain = bowl_job(0.7, 0.8, fit=False)
    job = replace(plain, settings=replace(plain.settings, bounces=bounces))
    results = baked(halves(job))
    (entry,) = results.report["objects"]
    assert entry["unbaked_places"] > 0
    assert entry["entries_without_light"] == 0
    (half,), (half_plain,) = results.receivers, baked(halves(plain)).receivers
    (whole,), (whole_plain,) = baked(job).receivers, baked(plain).receivers
    shown = half.element_points >= 0

    def added(result, direct):
        both = (result.at_elements(r.transfer) for r in (result, direct))
        return np.subtract(*both)[shown]

    truth = added(whole, whole_plain)
    size = np.sqrt((whole.transfer**2).mean())
    assert np.sqrt(((added(half, half_plain) - truth) ** 2).mean()) < 0.01 * size
    assert added(half, half_plain)[..., 0].mean() == pytest.approx(truth[..., 0].mean(), rel=0.01)


def test_the_back_of_an_open_sheet_passes_light_on():
    """A floor under a sheet that faces away from it."""
    floor = shapes.grid([-1, -1, 0], [2, 0, 0], [0, 2, 0], 12)
    sheet = shapes.grid([-1, -1, 0.8], [2, 0, 0], [0, 2, 0], 12)
    vertices, triangles = shapes.join(floor, sheet)
    body = replace(shapes.receiver(*floor), vertices=floor[0])
    faced = triangles.copy()
    faced[len(floor[1]) :] = faced[len(floor[1]) :, ::-1]
    found = [
        baked(job_of((body,), vertices, its, 0.8, bounces=3)).receivers[0].transfer
        for its in (triangles, faced)
    ]
    direct = baked(job_of((body,), vertices, triangles, 0.8)).receivers[0].transfer
    assert relative_rms(found[0], found[1]) < 0.01
    assert (found[0][:, 0, 0] > 1.02 * direct[:, 0, 0]).all()


def test_albedo_of_nothing_is_no_light():
    dark = baked(bowl_job(0.6, 0.0, bounces=3))
    direct = baked(bowl_job(0.6, 0.0))
    np.testing.assert_array_equal(dark.receivers[0].transfer, direct.receivers[0].transfer)


@pytest.fixture
def room(tmp_path):
    """A ball in a coloured box that is open to the front, under a sky with a sun."""
    walls = shapes.box(2.0, 6)
    walls = (walls[0], walls[1][72:])
    ball = shapes.sphere(12, 24, 0.4)
    vertices, triangles = shapes.join(walls, ball[:2])
    box = replace(shapes.receiver(*walls, name="box"), vertices=walls[0])
    body = replace(shapes.receiver(*ball, name="ball"), vertices=ball[0])
    job = job_of(
        (box, body), vertices, triangles, [0.8, 0.5, 0.2], rays=64, bounces=2, residual=True
    )
    settings = replace(job.settings, cache=str(tmp_path / "cache"))
    return replace(job, settings=settings, light=jobs.LightSource(pixels=sky(0)))


def rays_of(results):
    return [entry["rays"] for entry in results.report["objects"]]


def test_an_unchanged_scene_costs_no_ray(room):
    first, second = baked(room), baked(room)
    assert min(rays_of(first)) > 0
    assert rays_of(second) == [0, 0]
    for a, b in zip(first.receivers, second.receivers, strict=True):
        np.testing.assert_array_equal(a.transfer, b.transfer)
        np.testing.assert_array_equal(a.residual, b.residual)


def test_another_light_traces_only_towards_its_map(room):
    baked(room)
    other = replace(room, light=jobs.LightSource(pixels=sky(1)))
    cached = baked(other)
    fresh = baked(replace(other, settings=replace(room.settings, cache="")))
    for a, b in zip(cached.receivers, fresh.receivers, strict=True):
        np.testing.assert_array_equal(a.transfer, b.transfer)
        np.testing.assert_array_equal(a.residual, b.residual)
    for entry in cached.report["objects"]:
        assert entry["rays"] == entry["map_rays"] > 0


def test_other_albedos_and_bounces_cost_no_ray_but_are_another_result(room):
    first = baked(room)
    redder = replace(room, occluder_albedo=room.occluder_albedo[..., ::-1].copy())
    once = replace(room, settings=replace(room.settings, bounces=1))
    for other in (redder, once):
        again = baked(other)
        assert all(o["rays"] == o["map_rays"] for o in again.report["objects"])
        assert relative_rms(again.receivers[0].transfer, first.receivers[0].transfer) > 0.005
    turned = baked(redder).receivers[0].transfer
    np.testing.assert_allclose(turned[:, ::-1], first.receivers[0].transfer, atol=2e-4)


def direct_light(job, scene, origins, normals, fine=2):
    """Exit radiance (P, 3) of white surfaces by a ray to every texel of the map, and in between."""
    pixels = job.light.pixels
    height, width = (fine * size for size in pixels.shape[:2])
    directions = lat_long.directions(height, width).reshape(-1, 3)
    weight = np.repeat(lat_long.row_solid_angles(height, width), width)
    radiance = pixels.repeat(fine, 0).repeat(fine, 1).reshape(-1, 3) * weight[:, None]
    found = np.empty((len(origins), 3))
    for p, (origin, normal) in enumerate(zip(origins, normals, strict=True)):
        cosine = np.maximum(directions @ normal, 0)
        start = np.repeat(np.float32([origin]), len(directions), axis=0)
        seen = scene.sky_mask(start, directions.astype(np.float32)) != 0
        found[p] = (cosine * seen) @ radiance / np.pi
    return found


def test_at_the_baked_world_the_light_that_bounced_is_there_too(room):
    """What the coefficients hold and the residual together, against direct light at 400 places that
    a place sees."""
    settings = replace(room.settings, rays=512, cache="", fit=False, bounces=1)
    job = replace(room, settings=settings)
    results = baked(job)
    light = world_sh(results.image_sh, (1, 1, 1), np.eye(3))[:9]
    result, points = results.receivers[0], distinct_points(job.receivers[0])
    chosen = np.arange(0, len(points.origins), 40)
    scene = rays.occlusion(job.occluder_vertices, job.occluder_triangles)
    walls = Walls(scene, job.occluder_vertices, job.occluder_triangles, job.occluder_albedo)
    origins, normals = points.origins[chosen], points.normals[chosen].astype(float)
    truth = direct_light(job, scene, origins, normals)
    for p, matrix in enumerate(frames(normals, np.arange(len(normals))).matrices()):
        towards = (cosine_fibonacci(400) @ matrix.T).astype(np.float32)
        met = scene.first_met(np.repeat(origins[p : p + 1], 400, axis=0), towards)
        hit = met.triangles >= 0
        places, facing, albedo, off = walls.at(met.triangles[hit], met.u[hit], met.v[hit])
        there = direct_light(job, scene, places + off * facing, facing, fine=1)
        truth[p] += (albedo * there).sum(axis=0) / 400
    plain = exit_radiance(result.transfer[chosen], light)
    assert relative_rms(plain + result.residual[chosen, 0], truth) < 0.04
    assert relative_rms(plain, truth) > 0.1


def test_another_light_costs_rays_towards_its_map_alone_where_things_stand_by(room):
    alone = replace(room, receivers=room.receivers[:1])
    first = baked(alone).report["objects"][0]
    other = baked(replace(alone, light=jobs.LightSource(pixels=sky(1)))).report["objects"][0]
    assert first["unbaked_places"] == other["unbaked_places"] > 0
    assert other["rays"] == other["map_rays"]
    assert other["unbaked_rays"] < 0.8 * first["unbaked_rays"]


def test_the_size_of_batches_changes_nothing(monkeypatch):
    job = well_job(0, [0.8, 0.5, 0.2], bounces=2, rays=64)
    whole = baked(job)
    monkeypatch.setattr(transfer, "BATCH_RAYS", 4096)
    np.testing.assert_array_equal(baked(job).receivers[0].transfer, whole.receivers[0].transfer)


def test_a_finely_cut_floor_takes_no_more_places_than_a_coarse_one():
    ball = shapes.sphere(32, 64, 0.5)
    body = shapes.receiver(*ball, name="ball")
    found = []
    for count in (48, 160):
        floor = shapes.grid([-1.5, -1.5, -0.6], [3, 0, 0], [0, 3, 0], count)
        vertices, triangles = shapes.join(ball[:2], floor)
        found.append(baked(job_of((body,), vertices, triangles, 0.8, bounces=2)))
    places = [results.report["objects"][0]["unbaked_places"] for results in found]
    assert 0 < places[1] < 1.2 * places[0]
    coarse, fine = (results.receivers[0].transfer for results in found)
    assert relative_rms(fine, coarse) < 0.01
