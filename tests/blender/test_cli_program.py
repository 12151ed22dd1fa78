"""The program ``prt-bake``, as a farm runs it."""

import json
import os
import signal
import subprocess
import sys
import time

import bpy
import pytest

MAIN = "import sys; from prt_baker.addon.cli import main; sys.exit(main())"


@pytest.fixture
def blend(scene, tmp_path):
    """A saved file with two objects, its path hard to write."""
    scene.world = bpy.data.worlds.new("World")
    bpy.ops.mesh.primitive_monkey_add()
    bpy.context.object.name = "Ällike ../x"
    path = tmp_path / "Süd szene.blend"
    bpy.ops.wm.save_as_mainfile(filepath=str(path))
    return path


def prt_bake(*arguments, **keywords):
    """Run the program to its end."""
    command = [sys.executable, "-c", MAIN, *map(str, arguments)]
    return subprocess.run(
        command, check=False, capture_output=True, text=True, timeout=300, **keywords
    )


def test_a_bake_from_file_to_files(blend, tmp_path):
    out = tmp_path / "Ergebnis 1"
    out.mkdir()
    paths = [out / "ü.blend", out / "ü.glb", out / "ü.json"]
    flags = zip(("--save", "--gltf", "--report"), paths, strict=True)
    done = prt_bake(
        blend, "--rays", 16, "--object", "Ällike ../x", *(word for pair in flags for word in pair)
    )
    assert done.returncode == 0, done.stderr
    assert sorted(out.iterdir()) == sorted(paths)
    assert json.loads(paths[2].read_text("utf-8"))["objects"][0]["name"] == "Ällike ../x"
    assert "rays a point" in done.stdout.splitlines()[-1]
    bpy.ops.wm.open_mainfile(filepath=str(paths[0]))
    assert bpy.data.objects["Ällike ../x"]["prt_baked"] == 1.0


def test_a_bake_into_a_texture_lies_beside_what_is_saved(blend, tmp_path):
    out = tmp_path / "out"
    out.mkdir()
    size = "--carrier", "texture", "--resolution", 512, "--rays", 16
    where = "--save", out / "lit.blend", "--gltf", out / "lit.glb", "--report", out / "r.json"
    done = prt_bake(blend, *size, *where)
    assert done.returncode == 0, done.stderr
    assert done.stderr.count("glTF") == 0, done.stderr
    assert "texels of 512 x 512" in done.stdout
    names = sorted(path.name for path in out.iterdir())
    assert names == ["lit PRT.exr", "lit.blend", "lit.glb", "r.json"]
    [entry] = json.loads((out / "r.json").read_text("utf-8"))["objects"]
    assert entry["carrier"] == "texture"
    bpy.ops.wm.open_mainfile(filepath=str(out / "lit.blend"))
    obj = bpy.data.objects["Ällike ../x"]
    assert obj["prt_baked"] == 1.0
    assert obj["prt_image"].filepath == "//lit PRT.exr"
    assert tuple(obj["prt_image"].size) == (1024, 1024)


@pytest.mark.parametrize("damage", ["missing", "folder", "garbage", "cut short", "empty"])
def test_a_bad_blend_is_one_sentence(blend, tmp_path, damage):
    path = tmp_path / "bad one.blend"
    content = {"garbage": b"no blend" * 99, "cut short": blend.read_bytes()[:5000], "empty": b""}
    if damage == "folder":
        path.mkdir()
    elif damage in content:
        path.write_bytes(content[damage])
    done = prt_bake(path)
    assert done.returncode == 2, done.stderr
    assert "Traceback" not in done.stderr
    lines = done.stderr.strip().splitlines()
    assert lines[-1].startswith(f"prt-bake: {path} ")


def test_a_bad_option_needs_no_blender():
    since = time.monotonic()
    done = prt_bake("x.blend", "--order", "9", env={**os.environ, "PYTHONVERBOSE": ""})
    assert done.returncode == 2
    assert done.stderr.startswith("prt-bake: ")
    assert time.monotonic() - since < 5


def test_ctrl_c_is_130_and_leaves_nothing(blend, tmp_path):
    temporary, out = tmp_path / "tmp", tmp_path / "out"
    temporary.mkdir()
    out.mkdir()
    arguments = [blend, "--rays", "65536", "--save", out / "a.blend", "--report", out / "a.json"]
    program = subprocess.Popen(
        [sys.executable, "-c", MAIN, *map(str, arguments)],
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        text=True,
        env={**os.environ, "TMPDIR": str(temporary)},
        start_new_session=True,
    )
    for line in program.stderr:
        if line.startswith("Tracing"):
            break
    os.killpg(program.pid, signal.SIGINT)  # a terminal interrupts the engine too
    _, error = program.communicate(timeout=30)
    assert program.returncode == 130, error
    assert "interrupted" in error
    assert list(out.iterdir()) == []
    assert [path for path in temporary.iterdir() if path.name.startswith("prt-")] == []
