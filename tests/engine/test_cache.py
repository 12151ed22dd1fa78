"""What is kept comes back whole or not at all, and only for what would give the same."""

import os
import resource
import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest
import shapes
from prt_baker.addon.prt import cache as caches
from prt_baker.addon.prt import job as jobs
from prt_baker.addon.prt.cache import Cache, Keys

ARRAYS = {
    "transfer": np.random.default_rng(0).random((50, 9), np.float32),
    "bits": np.arange(255, dtype=np.uint8)[::-2],
    "none": np.empty((0, 3), np.int64),
}
REPORT = {"name": "Würfel ☃", "rays": 2**40, "error": None}


@pytest.fixture
def cache(tmp_path):
    return Cache(tmp_path / "new" / "cache")


def files(cache):
    return sorted(cache._folder.iterdir()) if cache._folder.exists() else []


def assert_kept(entry, arrays=ARRAYS):
    assert entry is not None
    assert entry.report == REPORT
    assert list(entry.arrays) == list(arrays)
    for name, array in arrays.items():
        np.testing.assert_array_equal(entry.arrays[name], array)
        assert entry.arrays[name].dtype == array.dtype


def test_what_is_put_comes_back_and_cannot_be_changed(cache):
    assert cache.get("a") is None
    assert cache.put("a", ARRAYS, REPORT)
    entry = cache.get("a")
    assert_kept(entry)
    assert cache.get("b") is None
    with pytest.raises(ValueError, match="read-only"):
        entry.arrays["transfer"][0] = 1


def test_without_a_folder_nothing_is_kept(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert not Cache("").put("a", ARRAYS, REPORT)
    assert Cache("").get("a") is None
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("length", [0, 1, 40, 60, 500, -1])
def test_a_truncated_entry_is_missing_and_goes(cache, length):
    cache.put("a", ARRAYS, REPORT)
    (file,) = files(cache)
    file.write_bytes(file.read_bytes()[:length])
    assert cache.get("a") is None
    assert cache.put("a", ARRAYS, REPORT)
    assert_kept(cache.get("a"))


def test_an_entry_with_any_byte_changed_is_missing(cache):
    small = {"x": np.arange(3, dtype=np.float32)}
    cache.put("a", small, REPORT)
    (file,) = files(cache)
    whole = file.read_bytes()
    for place in range(len(whole)):
        damaged = bytearray(whole)
        damaged[place] ^= 0x10
        file.write_bytes(damaged)
        assert cache.get("a") is None, place
    file.write_bytes(whole)
    assert_kept(cache.get("a"), small)


def test_what_was_used_longest_ago_goes_first(cache):
    array = {"x": np.zeros(1000, np.uint8)}
    small = Cache(cache._folder, 4000)
    for i, key in enumerate("abc"):
        assert small.put(key, array, {})
        os.utime(files(small)[-1], (i, i))
    assert small.get("a") is not None
    assert small.put("d", array, {})
    assert [small.get(key) is not None for key in "abcd"] == [True, False, True, True]


def test_the_folder_never_holds_more_than_its_limit(cache):
    small = Cache(cache._folder, 5000)
    for i in range(30):
        small.put(f"{i}", {"x": np.zeros(100 + 37 * i, np.uint8)}, {})
        assert sum(file.stat().st_size for file in files(small)) < 5000 + 500
    assert not small.put("large", {"x": np.zeros(5001, np.uint8)}, {})


def test_a_full_folder_is_not_looked_at_for_every_entry(cache, monkeypatch):
    looks = []

    def listed(folder):
        looks.append(folder)
        return found(folder)

    found = caches._files
    monkeypatch.setattr(caches, "_files", listed)
    small = Cache(cache._folder, 200_000)
    for i in range(500):
        assert small.put(f"{i}", {"x": np.zeros(1000, np.uint8)}, {})
    assert 15 < len(looks) < 60
    assert sum(file.stat().st_size for file in files(small)) <= 200_000
    looks.clear()
    again = Cache(cache._folder, 1_000_000)
    for i in range(500, 600):
        assert again.put(f"{i}", {"x": np.zeros(1000, np.uint8)}, {})
    assert len(looks) == 1


def test_what_a_killed_process_left_is_cleared_away(cache):
    cache.put("a", ARRAYS, REPORT)
    left = cache._folder / ("b" + caches.UNFINISHED)
    for age, stays in ((10, True), (10000, False)):
        left.write_bytes(b"half")
        then = left.stat().st_mtime - age
        os.utime(left, (then, then))
        Cache(cache._folder).put("c", ARRAYS, REPORT)
        assert left.exists() is stays
    assert_kept(cache.get("a"))


def test_a_full_disk_keeps_nothing_and_stops_nothing(cache):
    cache.put("a", ARRAYS, REPORT)
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (100_000, before[1]))
    try:
        assert not cache.put("b", {"x": np.zeros(1_000_000, np.uint8)}, {})
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
    assert len(files(cache)) == 1
    assert_kept(cache.get("a"))


def test_a_folder_that_cannot_be_made_stops_nothing(tmp_path):
    (tmp_path / "file").touch()
    cache = Cache(tmp_path / "file" / "cache")
    assert not cache.put("a", ARRAYS, REPORT)
    assert cache.get("a") is None


def test_a_folder_that_may_only_be_read_still_gives(cache, monkeypatch):
    cache.put("a", ARRAYS, REPORT)

    def refused(*_, **__):
        raise PermissionError(13, "Permission denied")

    for module, name in ((os, "utime"), (caches.Path, "open"), (caches.Path, "unlink")):
        monkeypatch.setattr(module, name, refused)
    assert_kept(cache.get("a"))
    assert not cache.put("b", ARRAYS, REPORT)


WORKER = """
import sys, numpy as np
from prt_baker.addon.prt.cache import Cache
cache = Cache(sys.argv[1], 200_000)
for i in range(150):
    value = i % 7
    cache.put(f"k{value}", {"x": np.full(50_000, value, np.uint8)}, {"value": value})
    entry = cache.get(f"k{(i + 3) % 7}")
    if entry is not None:
        assert (entry.arrays["x"] == entry.report["value"]).all()
        assert entry.report["value"] == (i + 3) % 7
"""


def test_processes_share_a_folder(tmp_path):
    command = [sys.executable, "-c", WORKER, str(tmp_path)]
    running = [subprocess.Popen(command, stderr=subprocess.PIPE, text=True) for _ in range(3)]
    for process in running:
        assert process.communicate()[1] == ""
    assert all(file.suffix == caches.SUFFIX for file in tmp_path.iterdir())


@pytest.fixture
def job():
    """Two receivers, three occluders."""
    mesh = shapes.grid([0, 0, 0], [1, 0, 0], [0, 1, 0], 2)
    crate = shapes.grid([3, 0, 0], [1, 0, 0], [0, 1, 0], 1)
    vertices, triangles = shapes.join(mesh, crate, mesh)
    receivers = tuple(
        shapes.receiver(*part, name=name) for part, name in ((mesh, "a"), (crate, "b"))
    )
    light = jobs.LightSource(pixels=np.ones((2, 4, 3), np.float32))
    starts = np.array([0, 8, 10, 18])
    return jobs.Job("bake", jobs.Settings(), light, receivers, vertices, triangles, {}, starts)


def key(job, parts=(0, 1), with_light=False, index=0, what="result"):
    return Keys(job).receiver(what, index, parts, with_light)


def with_settings(job, **values):
    return replace(job, settings=replace(job.settings, **values))


def test_a_key_sees_its_receiver_its_occluders_and_what_decides(job):
    receiver = job.receivers[0]
    moved = replace(receiver, vertices=receiver.vertices + np.float32(1e-6))
    shift = np.zeros((len(job.occluder_vertices), 1))
    shift[9:13] = 1e-6  # the crate's
    others = [
        key(job),
        key(job, what="visibility"),
        key(job, with_light=True),
        key(job, index=1),
        key(job, parts=(0,)),
        key(job, parts=(0, 1, 2)),
        key(with_settings(job, seed=1)),
        key(with_settings(job, rays=255)),
        key(with_settings(job, order=4)),
        key(with_settings(job, tolerance=0.1)),
        key(with_settings(job, fit=False)),
        key(replace(job, receivers=(moved, job.receivers[1]))),
        key(replace(job, occluder_vertices=job.occluder_vertices + shift)),
    ]
    assert len(set(others)) == len(others)


def test_a_key_sees_the_light_only_where_it_should(job, tmp_path):
    places = [tmp_path / "a.exr", tmp_path / "b.exr", tmp_path / "same.exr"]
    for place, content in zip(places, (b"sky", b"night", b"sky"), strict=True):
        place.write_bytes(content)
    variants = [
        job,
        replace(job, light=replace(job.light, pixels=job.light.pixels * 2)),
        replace(job, light=replace(job.light, strength=(1, 2, 3))),
        *(replace(job, light=jobs.LightSource(image=str(place))) for place in places[:2]),
        *(with_settings(job, **{name: 7}) for name in ("map_rays", "turns", "peaks")),
        with_settings(job, residual=False),
        with_settings(job, final_light=True),
    ]
    assert len({key(variant) for variant in variants}) == 1
    assert len({key(variant, with_light=True) for variant in variants}) == len(variants)
    elsewhere = replace(job, light=jobs.LightSource(image=str(places[2]), title="Sky"))
    assert key(elsewhere, with_light=True) == key(variants[3], with_light=True)


def test_a_key_does_not_see_what_changes_nothing(job):
    first, second = job.receivers
    same = [
        with_settings(job, threads=7, cache="/tmp/x", verify_points=5, verify_rays=5),
        replace(job, receivers=(replace(first, name="other"), second)),
        replace(job, receivers=(first, replace(second, vertices=second.vertices + 1))),
        replace(job, repairs={"dropped_triangles": 3}),
    ]
    assert {key(each, with_light=True) for each in same} == {key(job, with_light=True)}


def test_a_key_does_not_see_the_order_of_the_occluders_nor_those_out_of_reach(job):
    assert key(job, parts=(1, 0)) == key(job, parts=[0, 1]) == key(job, parts=np.array([2, 1]))
    vertices = np.array(job.occluder_vertices)
    vertices[13:] += 1  # the third object's
    assert key(replace(job, occluder_vertices=vertices)) == key(job)
    assert key(replace(job, occluder_vertices=vertices), parts=(2, 1)) != key(job, parts=(2, 1))


def test_a_key_sees_the_program(job, monkeypatch):
    before = key(job)
    monkeypatch.setattr(caches, "VERSION", "0.0.0")
    assert key(job) != before


def test_every_part_is_hashed_once_and_only_when_needed(job, monkeypatch):
    hashed = []
    once = caches.add_array
    monkeypatch.setattr(caches, "add_array", lambda d, n, a: hashed.append(n) or once(d, n, a))
    keys = Keys(job)
    for index in (0, 1):
        keys.receiver("result", index, (0, 1), with_light=False)
        keys.receiver("visibility", index, (1, 0), with_light=False)
    in_receivers = 4 * len(jobs.RECEIVER_ARRAYS)
    assert len(hashed) - in_receivers == 2 * 2


def test_a_job_read_back_has_the_keys_of_before(job, tmp_path):
    near = replace(job, occluder_vertices=job.occluder_vertices.astype(np.float32))
    jobs.write(near, tmp_path)
    assert key(jobs.read(tmp_path), with_light=True) == key(near, with_light=True)
