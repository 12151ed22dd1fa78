"""A whole run, in this process and in the engine's own."""

import contextlib
import json
import sys
import time
from contextlib import closing
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import shapes
from prt_baker.addon import engine
from prt_baker.addon.prt import __main__ as program
from prt_baker.addon.prt import job as jobs
from prt_baker.addon.prt import parallel, sh
from prt_baker.addon.prt.errors import BakeError
from prt_baker.addon.prt.run import run


def finish(steps):
    """Everything that a generator yields, and its value."""
    seen = []
    while True:
        try:
            seen.append(next(steps))
        except StopIteration as stop:
            return seen, stop.value


@pytest.fixture
def job():
    vertices, triangles, normals = shapes.sphere(16, 32)
    ball = replace(shapes.receiver(vertices, triangles, normals), vertices=vertices)
    floor = shapes.grid([-3, -3, -1], [6, 0, 0], [0, 6, 0], 20)
    ground = replace(shapes.receiver(*floor, name="floor"), vertices=floor[0])
    everything = shapes.join((vertices, triangles), floor)
    settings = jobs.Settings(rays=64, verify_points=20, verify_rays=4096)
    return jobs.Job("bake", settings, jobs.LightSource(), (ball, ground), *everything)


def test_the_child_process_gives_the_same_bits(job, tmp_path):
    jobs.write(job, tmp_path)
    _, here = finish(run(jobs.read(tmp_path)))
    with engine.job_folder() as folder:
        _, there = finish(engine.run(job, folder))
    for mine, its in zip(here.receivers, there.receivers, strict=True):
        np.testing.assert_array_equal(mine.transfer, its.transfer)
        np.testing.assert_array_equal(mine.element_points, its.element_points)
    np.testing.assert_array_equal(here.image_sh, there.image_sh)


def test_the_report_adds_up(job):
    steps, results = finish(run(job))
    report = results.report
    ball, floor = report["objects"]
    assert (ball["name"], floor["name"]) == ("shape", "floor")
    assert floor["points"] == 21 * 21
    assert floor["skipped"]["the same position and normal"] == (20 * 20 * 6 - 21 * 21) * 64
    above = "nothing stands above the horizon"
    assert all(o["rays"] + o["skipped"].get(above, 0) >= o["points"] * 64 for o in (ball, floor))
    assert 0 < ball["estimated_error"] < 0.1
    assert ball["measured_error"]["at_points"] < 0.1
    assert [s.fraction for s in steps] == sorted(s.fraction for s in steps)
    assert steps[-1].fraction == pytest.approx(1)


def test_a_verified_bake_measures_what_the_bake_measured(job):
    _, baked = finish(run(job))
    receivers = tuple(
        replace(r, transfer=result.at_elements(result.transfer))
        for r, result in zip(job.receivers, baked.receivers, strict=True)
    )
    _, verified = finish(run(replace(job, kind="verify", light=None, receivers=receivers)))
    for first, second in zip(baked.report["objects"], verified.report["objects"], strict=True):
        before, after = first["measured_error"], second["measured_error"]
        # where rays started is only known while it bakes: afterwards the points are looked at, and
        # some are dark that those were not, so that other rays ask whether they are buried
        its_own = ("at_points", "rays")
        assert {**before, **{name: after[name] for name in its_own}} == after


def test_verify_sees_a_wrong_bake(job):
    _, baked = finish(run(job))
    wrong = [result.at_elements(result.transfer) * 1.2 for result in baked.receivers]
    receivers = tuple(replace(r, transfer=t) for r, t in zip(job.receivers, wrong, strict=True))
    _, verified = finish(run(replace(job, kind="verify", light=None, receivers=receivers)))
    assert verified.report["objects"][0]["measured_error"]["at_points"] == pytest.approx(
        0.2, abs=0.03
    )


def test_a_white_world_lights_an_open_white_plane_white():
    vertices, triangles = shapes.grid([0, 0, 0], [1, 0, 0], [0, 1, 0], 3)
    plane = shapes.receiver(vertices, triangles)
    white = jobs.Job("bake", jobs.Settings(), jobs.LightSource(), (plane,), vertices, triangles)
    _, results = finish(run(white))
    transfer = results.receivers[0].transfer[:, 0]
    np.testing.assert_allclose(transfer @ results.image_sh[:9], 1, atol=1e-5)
    expected = np.broadcast_to(sh.open_transfer([0, 0, 1.0], 3), transfer.shape)
    np.testing.assert_allclose(transfer, expected, atol=1e-5)


def test_a_missing_image_is_one_sentence_from_the_child(tmp_path):
    light = jobs.LightSource(image="/nowhere/sky.exr")
    with pytest.raises(BakeError, match=r"sky\.exr"):
        engine.run_light(light, tmp_path)


def test_a_fault_of_ours_keeps_its_traceback(tmp_path, job):
    broken = replace(job, receivers=(replace(job.receivers[0], normals=np.zeros((3, 3))),))
    with pytest.raises(RuntimeError, match="Traceback"):
        finish(engine.run(broken, tmp_path))


def children():
    """The command lines of the running engines."""
    lines = []
    for path in Path("/proc").glob("[0-9]*/cmdline"):
        with contextlib.suppress(OSError):
            lines.append(path.read_text(errors="replace"))
    return [line for line in lines if "run_module('prt'" in line]


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="reads the process table")
def test_cancel_kills_the_child_and_leaves_nothing(job):
    slow = replace(job, settings=replace(job.settings, rays=65536))
    with engine.job_folder() as folder, closing(engine.run(slow, folder)) as steps:
        while next(steps).phase != "transfer":
            pass
        assert any(str(folder) in child for child in children())
    assert not folder.exists()
    assert not any(str(folder) in child for child in children())


@pytest.mark.parametrize(
    "error",
    [OSError(28, "No space left on device"), OSError("76800 requested and 24576 written")],
)
def test_a_full_disk_is_one_sentence(job, monkeypatch, error):
    def full(*_):
        raise error

    monkeypatch.setattr(np, "save", full)
    with (
        pytest.raises(BakeError, match="No space left on device") as caught,
        engine.job_folder() as folder,
    ):
        finish(engine.run(job, folder))
    assert str(folder.parent) in str(caught.value)
    assert not folder.exists()


def test_an_error_of_another_kind_keeps_its_traceback():
    with pytest.raises(PermissionError), engine.job_folder():
        raise PermissionError(13, "Permission denied")


def test_writing_gives_signs_of_life(job, tmp_path, monkeypatch):
    jobs.write(job, tmp_path)
    write = program.write_results

    def slowly(results, folder):
        time.sleep(0.3)
        write(results, folder)

    monkeypatch.setattr(program, "write_results", slowly)
    monkeypatch.setattr(parallel, "TICK", 0.05)
    assert program.main(tmp_path) == 0
    lines = (tmp_path / program.PROGRESS).read_text("utf-8").splitlines()
    seconds = [json.loads(line)["seconds"] for line in lines]
    assert seconds[-1] > seconds[-4] + 0.14
    assert (tmp_path / "results").exists()


def test_results_without_room_are_one_sentence(job, tmp_path, monkeypatch):
    def full(*_):
        raise OSError("17694 requested and 11232 written")

    jobs.write(job, tmp_path)
    monkeypatch.setattr(program, "write_results", full)
    assert program.main(tmp_path) == 2
    last = json.loads((tmp_path / program.PROGRESS).read_text("utf-8").splitlines()[-1])
    assert "No space left on device" in last["error"]


def test_without_room_even_for_the_reason_there_is_one(job, tmp_path, monkeypatch):
    monkeypatch.setattr(program, "_say", lambda *_, **__: (tmp_path / "no" / "room").touch())
    monkeypatch.setattr(program, "_run", lambda *_: 1 / 0)
    assert program.main(tmp_path) == 2
    monkeypatch.setattr(engine, "BOOT", "import sys; sys.exit(2)")
    with pytest.raises(BakeError, match="No space left on device"):
        finish(engine.run(job, tmp_path))


def test_a_missing_package_is_one_sentence(job, tmp_path, monkeypatch):
    monkeypatch.setattr(engine, "NATIVE_PACKAGES", ("no_such_package",))
    with pytest.raises(BakeError, match="no_such_package"):
        finish(engine.run(job, tmp_path))


def test_the_child_ignores_what_lies_in_the_working_folder(job, tmp_path, monkeypatch):
    (tmp_path / "json.py").write_text("raise SystemExit(3)")
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))
    (tmp_path / "work").mkdir()
    results = engine.run_light(jobs.LightSource(), tmp_path / "work")
    assert results.image_sh.shape == (25, 3)
    assert Path("json.py").exists()
