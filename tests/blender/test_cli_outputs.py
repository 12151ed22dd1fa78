"""What the command line writes: whole, or not at all."""

import json
import resource
from contextlib import contextmanager
from pathlib import Path

import bpy
import pytest
from prt_baker.addon import bake, cli, gltf_export
from prt_baker.addon.prt.errors import BakeError
from prt_baker.addon.prt.job import Progress

NAMES = {"save": "Ünï bake.blend", "gltf": "my bake.glb", "report": "figures.json"}


@pytest.fixture
def cube(scene):
    """A cube under a white world."""
    scene.world = bpy.data.worlds.new("World")
    bpy.ops.mesh.primitive_cube_add()
    return bpy.context.object


@pytest.fixture
def runs(cube, monkeypatch):
    """A made-up bake, and how often it ran; the .glb is a few bytes."""
    ran = []

    def job(*_arguments):
        yield Progress("transfer", 0.5)
        ran.append(True)
        return {"objects": ["Ünï"], "notes": []}

    monkeypatch.setattr(bake, "bake", job)
    monkeypatch.setattr(gltf_export, "write", lambda path, _names: Path(path).write_bytes(b"glTF"))
    return ran


def options_for(folder):
    """Every output, in ``folder``."""
    return [word for name, file in NAMES.items() for word in (f"--{name}", str(folder / file))]


def refused(capsys, *arguments):
    """The one sentence that the command refuses ``arguments`` with."""
    assert cli.command([str(argument) for argument in arguments]) == 2
    lines = [line for line in capsys.readouterr().err.splitlines() if "%" not in line]
    assert len(lines) == 1
    return lines[0]


def test_everything_asked_for_is_written_and_nothing_else(runs, tmp_path):
    assert cli.command(options_for(tmp_path)) == 0
    assert sorted(path.name for path in tmp_path.iterdir()) == sorted(NAMES.values())
    report = json.loads((tmp_path / NAMES["report"]).read_text("utf-8"))
    assert report == {"objects": ["Ünï"], "notes": [], "lamps_left_out": [], "gltf": []}
    with bpy.data.libraries.load(str(tmp_path / NAMES["save"])) as (stored, _):
        assert stored.objects == ["Cube"]


def test_lamps_are_said_to_be_left_out(capsys, runs, tmp_path):
    bpy.ops.object.light_add(type="SUN")
    assert cli.command(["--report", str(tmp_path / "a.json")]) == 0
    assert json.loads((tmp_path / "a.json").read_text("utf-8"))["lamps_left_out"] == ["Sun"]
    assert "Lamps are not in the bake: Sun" in capsys.readouterr().err


def test_a_file_that_was_there_is_replaced(runs, tmp_path):
    target = tmp_path / NAMES["report"]
    target.write_text("old")
    assert cli.command(["--report", str(target)]) == 0
    assert json.loads(target.read_text("utf-8"))


def test_the_opened_file_stays_the_opened_file(runs, tmp_path):
    before = bpy.data.filepath
    assert cli.command(["--save", str(tmp_path / "copy.blend")]) == 0
    assert bpy.data.filepath == before


def test_relative_paths_hold_in_another_folder(runs, tmp_path):
    (tmp_path / "textures").mkdir()
    (tmp_path / "out").mkdir()
    image = bpy.data.images.new("Wood", 4, 4)
    image.filepath_raw = str(tmp_path / "textures" / "wood.png")
    image.save()
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "scene.blend"))
    image.filepath = "//textures/wood.png"
    image.use_fake_user = True
    assert cli.command(["--save", str(tmp_path / "out" / "baked.blend")]) == 0
    bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "out" / "baked.blend"))
    assert bpy.data.images["Wood"].filepath == "//../textures/wood.png"


@pytest.mark.parametrize("option", NAMES)
def test_no_ray_is_traced_for_a_place_that_cannot_be_written(capsys, runs, tmp_path, option):
    ending = Path(NAMES[option]).suffix
    folder = tmp_path / f"folder{ending}"
    folder.mkdir()
    assert "is a folder" in refused(capsys, f"--{option}", folder)
    assert "does not exist" in refused(capsys, f"--{option}", tmp_path / "no" / f"a{ending}")
    assert f"writes {ending}" in refused(capsys, f"--{option}", tmp_path / "a.png")
    assert "cannot be written" in refused(capsys, f"--{option}", f"/proc/a{ending}")
    assert runs == []
    assert [path.name for path in tmp_path.iterdir()] == [folder.name]


def test_one_output_that_fails_leaves_none(capsys, runs, tmp_path, monkeypatch):
    (tmp_path / NAMES["report"]).write_text("old")

    def fail(path, _names):
        raise BakeError(f"{path} cannot be written: the disk is full")

    monkeypatch.setattr(gltf_export, "write", fail)
    sentence = refused(capsys, *options_for(tmp_path))
    assert str(tmp_path / NAMES["gltf"]) in sentence, "the artist's name, not a passing one"
    assert [path.name for path in tmp_path.iterdir()] == [NAMES["report"]]
    assert (tmp_path / NAMES["report"]).read_text() == "old"


@contextmanager
def small_disk(size):
    """No file can become larger than ``size`` bytes."""
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)


@pytest.mark.parametrize("option", ["save", "report"])
def test_a_full_disk_is_one_sentence_and_leaves_nothing(capsys, runs, tmp_path, option):
    target = tmp_path / NAMES[option]
    with small_disk(8):
        assert cli.command([f"--{option}", str(target)]) == 2
    sentence = capsys.readouterr().err.splitlines()[-1]
    assert str(target) in sentence
    assert "cannot be written" in sentence
    assert list(tmp_path.iterdir()) == []
