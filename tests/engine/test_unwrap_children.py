"""The processes that unwrap start from the engine's, and none is ever left."""

import os
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
import shapes
from prt_baker.addon import engine
from prt_baker.addon.prt.atlas import children
from prt_baker.addon.prt.atlas.unwrap import unwrap
from prt_baker.addon.prt.errors import BakeError
from unwrapping import unwrapped


def test_a_mesh_that_kills_the_child_is_named(monkeypatch):
    monkeypatch.setattr(children, "BOOT", "import os, sys; sys.stdin.buffer.read(9); os._exit(3)")
    with pytest.raises(BakeError, match="'knot' cannot be unwrapped"):
        unwrapped(shapes.knot_scene(60, 8)[0])


HANGS_AFTERWARDS = """
import sys, time
sys.path.extend(sys.argv[1:])
from prt.atlas import charting, worker
charting.delete_atlases = lambda: time.sleep(1000)
worker.main()
"""


def test_a_child_that_hangs_after_its_answer_is_replaced(monkeypatch):
    expected = unwrapped(shapes.knot_scene(60, 8)[0])
    started = []
    start = children.Children._start
    monkeypatch.setattr(
        children.Children, "_start", lambda self: started.append(start(self)) or started[-1]
    )
    monkeypatch.setattr(children, "BOOT", HANGS_AFTERWARDS)
    monkeypatch.setattr(children, "PATIENCE", 0.2)
    found = unwrapped(shapes.knot_scene(60, 8)[0])
    np.testing.assert_array_equal(found.uvs, expected.uvs)
    assert len(started) > 2
    assert all(process.poll() is not None for process in started)


def test_closing_ends_the_children_at_once(monkeypatch):
    started = []
    start = children.Children._start
    monkeypatch.setattr(
        children.Children, "_start", lambda self: started.append(start(self)) or started[-1]
    )
    steps = unwrap(
        [shapes.receiver(*shapes.torus_knot(2000, 25))],
        size=1024, density=0.0, padding=2, threads=2,
    )  # fmt: skip
    for _ in steps:
        if started:
            break
    next(steps)
    since = time.perf_counter()
    steps.close()
    assert time.perf_counter() - since < 1
    assert len(started) >= 2  # more where one was slow and was replaced
    assert all(process.poll() is not None for process in started)


AS_THE_ENGINE = """
import os, sys
sys.path.extend(sys.argv[1:])
import numpy as np
from prt.atlas.unwrap import unwrap
from prt.job import Receiver
count = int(os.environ["ROWS"])
x, y = (a.reshape(-1) for a in np.meshgrid(np.arange(count), np.arange(count)))
vertices = np.stack([x, y, 5 * np.sin(0.1 * x) * np.cos(0.1 * y)], 1).astype(np.float32)
corner = (np.arange(count - 1)[:, None] * count + np.arange(count - 1)).reshape(-1)
quads = np.stack([corner, corner + 1, corner + count + 1, corner + count], 1).astype(np.int32)
triangles = np.concatenate([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]])
corners = np.arange(triangles.size, dtype=np.int32).reshape(-1, 3)
normals = np.tile(np.float32([0, 0, 1]), (len(vertices), 1))
receiver = Receiver("sheet", "POINT", vertices, triangles, corners, triangles.reshape(-1), normals)
for done in unwrap([receiver], size=256, density=0.0, padding=2, threads=2):
    print("step", done, flush=True)
print("done")
"""


def as_the_engine(rows):
    """A process with the engine's flags and path that unwraps a sheet."""
    return subprocess.Popen(
        [sys.executable, "-I", "-c", AS_THE_ENGINE, *engine._child_path()],
        stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
        env={**os.environ, "ROWS": str(rows)},
    )  # fmt: skip


def test_children_start_from_the_engines_process():
    process = as_the_engine(rows=60)
    output, errors = process.communicate(timeout=120)
    assert output.splitlines()[-1:] == ["done"], errors


def family(pid):
    """The children of process ``pid``."""
    return [s for s in Path("/proc").glob("[0-9]*/status") if f"\nPPid:\t{pid}\n" in alive(s)]


def is_alive(status):
    return bool(alive(status))


def alive(status):
    """What ``status`` says of a process; "" of one that is gone, or dead and not buried yet."""
    try:
        text = status.read_text()
    except OSError:
        return ""
    return "" if "\nState:\tZ" in text else text


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="reads the process table")
def test_children_die_with_a_killed_engine():
    process = as_the_engine(rows=300)
    for _ in iter(process.stdout.readline, ""):
        alive = family(process.pid)
        if len(alive) == 2:
            break
    assert len(alive) == 2
    process.kill()
    process.communicate()
    for _ in range(40):
        if not any(map(is_alive, alive)):
            return
        time.sleep(0.05)
    raise AssertionError("the children live on")


def test_xatlas_is_not_needed_before_something_is_unwrapped():
    code = "import sys; import prt_baker.addon.prt.atlas.unwrap; print('xatlas' in sys.modules)"
    done = subprocess.run([sys.executable, "-c", code], check=True, capture_output=True, text=True)
    assert done.stdout.strip() == "False"


def test_without_xatlas_a_sentence_says_so(monkeypatch):
    monkeypatch.setattr(children, "PACKAGE", "a_package_that_is_missing")
    with pytest.raises(BakeError, match="is missing: install the extension again"):
        unwrapped(shapes.receiver(np.eye(3), [[0, 1, 2]]))
