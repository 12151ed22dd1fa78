"""What a bake skips because it is known, and what its residual mends."""

import time
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import numpy as np
import pytest
import shapes
from prt_baker.addon.prt import baking
from prt_baker.addon.prt import job as jobs
from prt_baker.addon.prt.cache import Cache
from prt_baker.addon.prt.errors import BakeError
from prt_baker.addon.prt.layout import Values
from prt_baker.addon.prt.light import residual
from prt_baker.addon.prt.light.projection import world_sh
from prt_baker.addon.prt.light.world import World
from prt_baker.addon.prt.meter import Meter
from prt_baker.addon.prt.run import run
from prt_baker.addon.prt.surface import points
from prt_baker.addon.prt.tracing import rays, transfer
from test_run import finish


def sky(seed, sun=300.0):
    """A smooth sky with a small sun in it, (32, 64, 3)."""
    rng = np.random.default_rng(seed)
    pixels = np.ones((32, 64, 3), np.float32) * rng.uniform(0.3, 1, 3).astype(np.float32)
    pixels[:16] *= 2
    pixels[rng.integers(3, 10), rng.integers(0, 64)] = sun
    return pixels


@pytest.fixture
def job(tmp_path):
    ball, faces, normals = shapes.sphere(16, 32)
    floor = shapes.grid([-3, -3, -1], [6, 0, 0], [0, 6, 0], 20)
    everything = shapes.join((ball, faces), floor)
    ground = replace(shapes.receiver(*floor, name="floor"), vertices=floor[0])
    body = replace(shapes.receiver(ball, faces, normals), vertices=ball)
    settings = jobs.Settings(rays=64, cache=str(tmp_path / "cache"))
    light = jobs.LightSource(pixels=sky(0))
    starts = np.array([0, len(faces), len(everything[1])])
    return jobs.Job("bake", settings, light, (body, ground), *everything, starts)


def rays_of(results):
    return [entry["rays"] for entry in results.report["objects"]]


def same(one, two):
    for a, b in zip(one.receivers, two.receivers, strict=True):
        for name in ("transfer", "residual", "element_points"):
            np.testing.assert_array_equal(getattr(a, name), getattr(b, name))


def test_an_unchanged_scene_costs_no_ray(job):
    _, first = finish(run(job))
    _, second = finish(run(job))
    assert min(rays_of(first)) > 0
    assert rays_of(second) == [0, 0]
    same(first, second)
    np.testing.assert_array_equal(first.image_sh, second.image_sh)


def test_another_light_traces_only_towards_its_map(job):
    finish(run(job))
    other = replace(job, light=jobs.LightSource(pixels=sky(1)))
    _, cached = finish(run(other))
    _, fresh = finish(run(replace(other, settings=replace(job.settings, cache=""))))
    same(cached, fresh)
    for entry in cached.report["objects"]:
        assert entry["rays"] == entry["map_rays"] > 0


def test_without_a_residual_another_light_costs_no_ray(job):
    plain = replace(job, settings=replace(job.settings, residual=False))
    _, first = finish(run(plain))
    _, second = finish(run(replace(plain, light=jobs.LightSource(pixels=sky(1)))))
    assert rays_of(second) == [0, 0]
    same(first, second)


def test_what_moves_below_a_floor_changes_nothing_for_it(job):
    """An occluder under the floor is out of its reach, not out of the ball's."""
    cellar = shapes.box(0.5, 2, inward=False)

    def with_cellar(x):
        moved = (cellar[0] + [x, 0, -3], cellar[1])
        vertices, triangles = shapes.join((job.occluder_vertices, job.occluder_triangles), moved)
        starts = np.append(job.occluder_starts, len(triangles))
        return replace(
            job, occluder_vertices=vertices, occluder_triangles=triangles, occluder_starts=starts
        )

    finish(run(with_cellar(0.0)))
    _, moved = finish(run(with_cellar(0.3)))
    ball, floor = rays_of(moved)
    assert ball > 0
    assert floor == 0


def test_the_structure_is_built_once_however_many_threads_want_it(job, monkeypatch):
    built = []

    def slowly(*_):
        time.sleep(0.05)
        built.append(rays.Sky())
        return built[-1]

    monkeypatch.setattr(baking, "occlusion", slowly)
    scene = baking.Scene(job, World(job, Cache("")), Cache(""), Meter())
    with ThreadPoolExecutor(8) as pool:
        found = list(pool.map(lambda _: scene.occlusion, range(8)))
    assert len(built) == 1
    assert all(its is built[0] for its in found)


def exact(job, result):
    """Exit radiance at the traced points by every texel of the map."""
    from prt_baker.addon.prt.light import lat_long

    receiver = job.receivers[1]
    where = points.distinct_points(receiver)
    pixels = job.light.pixels
    height, width = pixels.shape[:2]
    fine = 8  # directions a texel and axis
    directions = lat_long.directions(height * fine, width * fine).reshape(-1, 3)
    weight = np.repeat(lat_long.row_solid_angles(height * fine, width * fine), width * fine)
    radiance = pixels.repeat(fine, 0).repeat(fine, 1).reshape(-1, 3)
    scene = rays.occlusion(job.occluder_vertices, job.occluder_triangles)
    chosen = np.arange(0, len(where.origins), 37)
    found = []
    for p in chosen:
        cosine = np.maximum(directions @ where.normals[p], 0)
        start = np.repeat(where.origins[p : p + 1], len(directions), axis=0)
        seen = scene.sky_mask(start, directions.astype(np.float32)) != 0
        found.append((radiance * (weight * cosine * seen)[:, None]).sum(0) / np.pi)
    return chosen, np.array(found)


def test_the_light_is_exact_where_it_was_baked(job):
    sharp = replace(job, settings=replace(job.settings, rays=256, fit=False, cache=""))
    _, results = finish(run(sharp))
    result = results.receivers[1]
    chosen, truth = exact(sharp, result)
    light = world_sh(results.image_sh, (1, 1, 1), np.eye(3))[:9]
    plain = result.transfer[chosen, 0] @ light
    mended = plain + result.residual[chosen, 0]
    assert transfer.relative_rms(plain, truth) > 0.03
    assert transfer.relative_rms(mended, truth) < 0.012


def test_turned_residuals_are_those_of_turned_worlds(job):
    turned = replace(job, settings=replace(job.settings, turns=4, fit=False, cache=""))
    _, results = finish(run(turned))
    columns = sky(0).shape[1]
    for k in range(4):
        # a turn about Z by a quarter moves the picture by a quarter of its columns to the left
        pixels = np.roll(sky(0), -k * columns // 4, axis=1)
        one = replace(turned, light=jobs.LightSource(pixels=pixels))
        _, alone = finish(run(replace(one, settings=replace(one.settings, turns=1))))
        light = [world_sh(r.image_sh, (1, 1, 1), np.eye(3))[:9] for r in (results, alone)]
        for many, single in zip(results.receivers, alone.receivers, strict=True):
            exact_single = single.transfer[:, 0] @ light[1] + single.residual[:, 0]
            difference = many.residual[:, k] - single.residual[:, 0]
            assert np.sqrt((difference**2).mean() / (exact_single**2).mean()) < 0.03


def test_a_colour_has_no_residual(job):
    _, results = finish(run(replace(job, light=jobs.LightSource((1.0, 2.0, 3.0)))))
    assert results.receivers[0].residual.shape[1] == 0
    assert not any(entry["map_rays"] for entry in results.report["objects"])


def test_a_final_light_needs_one_band(job):
    """All that the coefficients would have held is in the residual."""
    final = replace(job, settings=replace(job.settings, final_light=True))
    _, whole = finish(run(job))
    _, cut = finish(run(final))
    light = world_sh(whole.image_sh, (1, 1, 1), np.eye(3))
    for a, b in zip(whole.receivers, cut.receivers, strict=True):
        assert b.transfer.shape[2] == 1
        before = a.transfer[:, 0] @ light[:9] + a.residual[:, 0]
        after = b.transfer[:, 0] @ light[:1] + b.residual[:, 0]
        np.testing.assert_allclose(after, before, atol=1e-4 * before.max())


def test_a_constant_final_light_needs_one_band_without_a_residual(job):
    settings = replace(job.settings, final_light=True)
    constant = replace(job, settings=settings, light=jobs.LightSource((1.0, 2.0, 3.0)))
    _, results = finish(run(constant))
    assert all(result.transfer.shape[2] == 1 for result in results.receivers)


def test_an_empty_band_is_not_stored_with_a_tolerance(job):
    """Order 4 of an open plane: the clamped cosine has nothing in band 3."""
    vertices, triangles = shapes.grid([0, 0, 0], [1, 0, 0], [0, 1, 0], 3)
    plane = replace(shapes.receiver(vertices, triangles), vertices=vertices)
    settings = jobs.Settings(order=4, tolerance=0.01)
    light = jobs.LightSource(pixels=sky(0))
    _, results = finish(run(jobs.Job("bake", settings, light, (plane,), vertices, triangles)))
    assert results.receivers[0].transfer.shape[2] == 9
    assert results.report["objects"][0]["bands_left_out"] == 1


def test_peaks_and_residual_together_are_as_exact_as_the_residual(job):
    """What the reader adds up: coefficients without the peaks, the peaks, the residual."""
    settings = replace(job.settings, rays=256, fit=False, cache="")
    lit = []
    for peaks in (0, 2):
        _, results = finish(run(replace(job, settings=replace(settings, peaks=peaks))))
        result = results.receivers[1]
        layout = Values(result.transfer, result.residual, result.visibility)
        light = world_sh(results.image_sh, (1, 1, 1), np.eye(3))
        by = residual.terms(light, light, 1, results.peaks)
        lit.append(residual.shaded(result.transfer, light) + residual.beyond(layout, by))
        assert len(results.peaks) == result.visibility.shape[1] == min(peaks, 1)
    assert transfer.relative_rms(lit[1], lit[0]) < 1e-4


def test_a_peak_alone_brings_most_of_the_light_back(job):
    """Order 3 and one sun, without a residual."""
    settings = replace(job.settings, rays=256, fit=False, cache="", residual=False, peaks=1)
    sunny = replace(job, settings=settings)
    _, results = finish(run(sunny))
    result = results.receivers[1]
    chosen, truth = exact(sunny, result)
    light = world_sh(results.image_sh, (1, 1, 1), np.eye(3))
    values = Values(result.transfer, np.empty((len(result.transfer), 0, 3)), result.visibility)
    by = residual.terms(light, light, 0, results.peaks)
    plain = residual.shaded(result.transfer, light)
    with_peak = plain + residual.beyond(values, by)
    before, after = (transfer.relative_rms(v[chosen], truth) for v in (plain, with_peak))
    assert after < 0.3 * before


def test_verify_measures_the_light_at_the_baked_world(job):
    settings = replace(job.settings, rays=256, cache="", verify_points=60, verify_rays=4096)
    errors = []
    for residual_too in (False, True):
        its = replace(settings, residual=residual_too)
        _, results = finish(run(replace(job, settings=its)))
        errors.append(results.report["objects"][1]["measured_error"]["light_at_points"])
    assert errors[1] < 0.4 * errors[0]


def test_a_receiver_without_area_is_refused(job):
    flat = replace(job.receivers[0], vertices=np.zeros_like(job.receivers[0].vertices))
    with pytest.raises(BakeError, match="without area"):
        finish(run(replace(job, receivers=(flat,))))
