"""The engine's process starts while its job is still written, and never outlives who started it."""

import subprocess
import sys
import time
from dataclasses import replace
from importlib.metadata import version
from pathlib import Path

import numpy as np
import pytest
import shapes
from prt_baker.addon import engine
from prt_baker.addon.prt import job as jobs
from prt_baker.addon.prt.packages import wheel_version
from prt_baker.addon.prt.results import read_results


@pytest.fixture
def job():
    vertices, triangles = shapes.grid([0, 0, 0], [1, 0, 0], [0, 1, 0], 2)
    receiver = shapes.receiver(vertices, triangles)
    return jobs.Job("bake", jobs.Settings(rays=16), None, (receiver,), vertices, triangles)


def test_settings_are_written_last_and_whole(job, tmp_path, monkeypatch):
    save, seen = np.save, []
    monkeypatch.setattr(np, "save", lambda *a: seen.append(jobs.is_written(tmp_path)) or save(*a))
    jobs.write(job, tmp_path)
    assert not any(seen)
    assert jobs.is_written(tmp_path)
    assert not list(tmp_path.glob("*.tmp"))


def test_a_child_waits_for_a_job_that_takes_long_to_write(job, tmp_path, monkeypatch):
    started, write = [], jobs.write
    start = engine._start
    monkeypatch.setattr(engine, "_start", lambda folder: started.append(1) or start(folder))

    def slowly(job, folder):
        assert started
        for _ in range(100):  # until the child runs our code
            time.sleep(0.05)
            if (folder / "progress.jsonl").exists():
                break
        write(job, folder)

    monkeypatch.setattr(jobs, "write", slowly)
    for _ in engine.run(job, tmp_path):
        pass
    assert len(read_results(tmp_path).receivers) == 1


LOADED = """
import sys
from pathlib import Path
from prt_baker.addon.prt import job as jobs
from prt_baker.addon.prt.results import write_results
from prt_baker.addon.prt.run import run
steps = run(jobs.read(Path(sys.argv[1])))
try:
    while True:
        next(steps)
except StopIteration as stop:
    write_results(stop.value, Path(sys.argv[1]))
print(*sys.modules, sep="\\n")
"""
NEEDLESS = ("atlas", "bounces", "files", "specular", "texture", "texturing", "verify", "choosing")


def test_a_plain_bake_loads_nothing_that_others_need(job, tmp_path):
    jobs.write(replace(job, light=jobs.LightSource()), tmp_path)
    command = [sys.executable, "-c", LOADED, str(tmp_path)]
    done = subprocess.run(command, check=True, capture_output=True, text=True)
    ours = "prt_baker.addon.prt."
    loaded = {name.removeprefix(ours).split(".")[0] for name in done.stdout.split()}
    assert "embreex" in loaded
    assert not loaded & {*NEEDLESS, "OpenEXR", "xatlas"}
    exact = {f"{ours}light.{part}" for part in ("exact", "gather", "peaks", "cubemap")}
    assert not exact & set(done.stdout.split())


@pytest.mark.parametrize("package", ["embreex", "OpenEXR"])
def test_a_package_is_asked_for_its_version_without_being_loaded(package):
    assert wheel_version(package) == version(package)
    assert wheel_version("nothing_of_the_kind") == "unknown"


ORPHAN = """
import os, sys
from pathlib import Path
from prt_baker.addon import engine
process = engine._start(Path(sys.argv[1]))
print(process.pid, flush=True)
os._exit(0)
"""


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="reads the process table")
def test_a_child_whose_parent_died_before_the_job_was_there_ends(tmp_path):
    command = [sys.executable, "-c", ORPHAN, str(tmp_path)]
    done = subprocess.run(command, check=True, capture_output=True, text=True)
    status = Path(f"/proc/{int(done.stdout)}/status")
    for _ in range(200):
        if not status.exists() or "\nState:\tZ" in status.read_text():
            return
        time.sleep(0.05)
    raise AssertionError("the child still waits")
