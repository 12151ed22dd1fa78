"""What an object costs beside its rays, where there are many."""

import threading
from dataclasses import replace

import numpy as np
import pytest
import shapes
from prt_baker.addon.prt import job as jobs
from prt_baker.addon.prt.parallel import workers
from prt_baker.addon.prt.run import run
from prt_baker.addon.prt.surface.points import distinct_points
from prt_baker.addon.prt.tracing import rays, transfer
from test_run import finish

POINTS, INSIDE = 150, 4  # of a box, and the places inside its triangles that tell how coarse it is


@pytest.fixture
def job():
    vertices, triangles = shapes.box(1.0, 4, inward=False)
    parts = [(vertices + np.array([1.1 * i, 0, 0]), triangles) for i in range(5)]
    receivers = tuple(shapes.receiver(*part, name=f"box {i}") for i, part in enumerate(parts))
    starts = np.cumsum([0, *(len(t) for _, t in parts)])
    everything = shapes.join(*parts)
    return jobs.Job("bake", jobs.Settings(rays=256), None, receivers, *everything, {}, starts)


def test_what_cannot_be_fitted_casts_no_ray_to_choose(job):
    """Beside those of its points and of a few places inside, only the estimate's quarter."""
    _, done = finish(run(job))
    for entry in done.report["objects"]:
        assert entry["points"] == POINTS
        whole = (POINTS + INSIDE) * 256
        assert entry["rays"] <= whole + whole / 4 + 16 * POINTS
        assert "effort" not in entry["seconds"]


def test_its_noise_is_what_the_estimate_says(job):
    _, done = finish(run(job))
    where = distinct_points(job.receivers[2])
    sky = rays.occlusion(job.occluder_vertices, job.occluder_triangles)
    truth = np.empty((POINTS, 9), np.float32)
    for _ in transfer.trace_all(where, sky, jobs.Settings(rays=65536, seed=9), truth):
        pass
    entry = done.report["objects"][2]
    error = transfer.relative_rms(done.receivers[2].transfer[:, 0], truth)
    assert entry["estimated_error"] == pytest.approx(error, rel=0.35)
    assert entry["surface_error"] > entry["interpolation_error"] > 0.01


def test_no_thread_is_started_for_little_work(job, monkeypatch):
    started = []
    start = threading.Thread.start

    def counted(thread):
        started.append(thread)
        start(thread)

    monkeypatch.setattr(threading.Thread, "start", counted)
    finish(run(job))
    for_all = len(started)
    started.clear()
    finish(run(replace(job, receivers=job.receivers[:1])))
    assert for_all == len(started)  # as for one


@pytest.mark.parametrize("is_little", [False, True])
def test_results_come_in_order_and_faults_are_raised(is_little):
    with workers(2, is_little) as pool:
        assert list(pool.map(abs, [-3, 2, -1])) == [3, 2, 1]
        assert pool.submit(divmod, 7, 2).result() == (3, 1)
        with pytest.raises(ZeroDivisionError):
            pool.submit(divmod, 1, 0).result()


def test_the_same_bits_with_threads_and_without(job, monkeypatch):
    _, first = finish(run(job))
    monkeypatch.setattr(transfer, "LITTLE", 0)
    _, second = finish(run(job))
    for one, other in zip(first.receivers, second.receivers, strict=True):
        np.testing.assert_array_equal(one.transfer, other.transfer)
