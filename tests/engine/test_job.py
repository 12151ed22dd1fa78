"""A job's folder: what is written reads back, and its hash names what decides the result."""

from dataclasses import replace

import numpy as np
import pytest
import shapes
from prt_baker.addon.prt import job as jobs
from prt_baker.addon.prt.results import ReceiverResult, Results, read_results, write_results


@pytest.fixture
def job():
    vertices, triangles = shapes.grid([10, 0, 0], [1, 0, 0], [0, 1, 0], 2)
    receiver = replace(shapes.receiver(vertices, triangles), vertices=vertices, name="Würfel/../ ☃")
    light = jobs.LightSource((1, 2, 3), pixels=np.ones((2, 4, 3), np.float32))
    return jobs.Job("bake", jobs.Settings(order=4), light, (receiver,), vertices, triangles)


def test_reads_back_what_was_written(job, tmp_path):
    jobs.write(job, tmp_path)
    read = jobs.read(tmp_path)
    assert (read.kind, read.settings, read.light) == (job.kind, job.settings, job.light)
    assert read.receivers[0].name == job.receivers[0].name
    np.testing.assert_array_equal(read.light.pixels, job.light.pixels)
    np.testing.assert_array_equal(read.receivers[0].triangles, job.receivers[0].triangles)


def test_vertices_are_centred_in_double_precision(job, tmp_path):
    far = np.array([1e6, -1e6, 1e6])
    moved = replace(job.receivers[0], vertices=job.receivers[0].vertices + far)
    vertices = job.occluder_vertices + far
    jobs.write(replace(job, receivers=(moved,), occluder_vertices=vertices), tmp_path)
    read = jobs.read(tmp_path)
    expected = job.occluder_vertices - [10, 0, 0]
    np.testing.assert_allclose(read.receivers[0].vertices, expected, atol=1e-9)
    np.testing.assert_array_equal(read.receivers[0].vertices, read.occluder_vertices)


def test_a_small_move_leaves_the_others_as_they_were(job, tmp_path):
    far = [1e5, -1e5, 0]
    seen = []
    for i, shift in enumerate((0, 0.1, -0.3)):
        (tmp_path / str(i)).mkdir()
        receiver = replace(
            job.receivers[0], vertices=job.receivers[0].vertices + far + [shift, 0, 0]
        )
        moved = replace(job, receivers=(receiver,), occluder_vertices=job.occluder_vertices + far)
        jobs.write(moved, tmp_path / str(i))
        seen.append(np.array(jobs.read(tmp_path / str(i)).occluder_vertices))
    np.testing.assert_array_equal(seen[0], seen[1])
    np.testing.assert_array_equal(seen[0], seen[2])
    assert np.abs(seen[0]).max() < 4


@pytest.mark.parametrize("size", [1e-6, 1, 3e5])
def test_receivers_stay_within_three_times_their_size_of_the_centre(job, tmp_path, size):
    place = np.array([12345.6, -77.7, 9e5])
    vertices = job.receivers[0].vertices * size + place
    jobs.write(replace(job, receivers=(replace(job.receivers[0], vertices=vertices),)), tmp_path)
    assert np.abs(jobs.read(tmp_path).receivers[0].vertices).max() <= 3 * size


def test_a_scene_about_the_origin_stays_where_it_is(job, tmp_path):
    vertices = job.receivers[0].vertices - [10, 0, 0]
    jobs.write(replace(job, receivers=(replace(job.receivers[0], vertices=vertices),)), tmp_path)
    np.testing.assert_array_equal(jobs.read(tmp_path).receivers[0].vertices, vertices)


def test_occluders_are_one_part_unless_told_apart(job, tmp_path):
    assert job.occluder_starts.tolist() == [0, 8]
    assert jobs.Job().occluder_starts.tolist() == [0]
    jobs.write(replace(job, occluder_starts=np.array([0, 3, 8])), tmp_path)
    assert jobs.read(tmp_path).occluder_starts.tolist() == [0, 3, 8]


@pytest.mark.parametrize("starts", [[0, 7], [1, 8], [0, 3]])
def test_parts_of_other_triangles_are_refused(job, starts):
    with pytest.raises(ValueError, match="cover"):
        replace(job, occluder_starts=np.array(starts))


def test_hash_ignores_threads_and_sees_everything_else(job):
    base = jobs.content_hash(job)
    settings = job.settings
    assert jobs.content_hash(replace(job, settings=replace(settings, threads=7))) == base
    moved = replace(job.receivers[0], vertices=job.receivers[0].vertices + 1e-6)
    others = [
        replace(job, settings=replace(settings, seed=1)),
        replace(job, settings=replace(settings, rays=128)),
        replace(job, light=replace(job.light, strength=(1, 2, 4))),
        replace(job, light=replace(job.light, pixels=job.light.pixels * 2)),
        replace(job, receivers=(moved,)),
        replace(job, occluder_triangles=job.occluder_triangles[::-1]),
        replace(job, occluder_starts=np.array([0, 4, 8])),
    ]
    assert len({base, *map(jobs.content_hash, others)}) == len(others) + 1


def test_hash_sees_what_a_picture_holds_and_not_where_it_lies(job, tmp_path):
    places = [tmp_path / "a.exr", tmp_path / "elsewhere.exr", tmp_path / "other.exr"]
    for place, content in zip(places, (b"sky", b"sky", b"night"), strict=True):
        place.write_bytes(content)
    hashes = [
        jobs.content_hash(replace(job, light=jobs.LightSource(image=str(place), title=place.name)))
        for place in [*places, tmp_path / "missing.exr"]
    ]
    assert hashes[0] == hashes[1]
    assert len(set(hashes)) == 3


def test_empty_arrays_survive(tmp_path):
    jobs.write(jobs.Job("light", light=jobs.LightSource()), tmp_path)
    assert jobs.read(tmp_path).occluder_triangles.shape == (0, 3)


def test_results_are_whole_or_absent(tmp_path):
    transfer = np.arange(18, dtype=np.float32).reshape(2, 1, 9)
    result = ReceiverResult("a", transfer, np.array([1, 0, -1], np.int32))
    write_results(Results(np.ones((25, 3)), (result,), {"x": 1}), tmp_path)
    read = read_results(tmp_path)
    np.testing.assert_array_equal(read.receivers[0].transfer, transfer)
    assert read.report == {"x": 1}
    assert [p.name for p in tmp_path.iterdir()] == ["results"]


def test_elements_without_a_point_show_nothing():
    transfer = np.ones((2, 1, 4), np.float32)
    result = ReceiverResult("a", transfer, np.array([1, -1], np.int32))
    np.testing.assert_array_equal(result.at_elements(result.transfer)[:, 0, 0], [1, 0])
