"""The command line: what it passes on, what it refuses, what it writes, and its exit codes."""

import contextlib
import json
import os
import signal
from pathlib import Path

import bpy
import pytest
from prt_baker.addon import bake, cli, gltf, gltf_export, gltf_panel, headless
from prt_baker.addon.atlas_files import Target
from prt_baker.addon.prt.errors import BakeError
from prt_baker.addon.prt.job import Progress


@pytest.fixture
def cube(scene):
    """A selected cube and one that is not, under a white world."""
    scene.world = bpy.data.worlds.new("World")
    for name in ("Stool", "Lamp Shade"):
        bpy.ops.mesh.primitive_cube_add()
        bpy.context.object.name = name
    return bpy.context.object


@pytest.fixture
def asked(cube, monkeypatch):
    """What a made-up bake was asked for."""
    calls = []

    def job(*arguments):
        yield Progress("transfer", 0.5, 100, 1.0)
        calls.append(arguments)
        return {"objects": [], "notes": []}

    monkeypatch.setattr(bake, "bake", job)
    monkeypatch.setattr(gltf_export, "write", lambda path, _names: Path(path).write_bytes(b"glTF"))
    return calls


@pytest.mark.parametrize("name", ["gltf_short", "gltf_ibl"])
def test_the_glb_is_as_it_is_asked_for(scene, asked, monkeypatch, tmp_path, name):
    chosen = []

    def write(path, _names):
        chosen.append(getattr(scene.prt, name))
        Path(path).write_bytes(b"glTF")

    monkeypatch.setattr(gltf_export, "write", write)
    for options in ([], [f"--{name.replace('_', '-')}"]):
        assert cli.command(["--gltf", str(tmp_path / "a.glb"), *options]) == 0
    assert chosen == [False, True]
    assert not getattr(scene.prt, name)


def test_the_glb_is_compressed_to_the_error_asked_for(scene, asked, monkeypatch, tmp_path):
    chosen = []

    def write(path, _names):
        chosen.append((scene.prt.gltf_compress, gltf_panel.wanted_error(scene)))
        Path(path).write_bytes(b"glTF")
        gltf.REPORT.append({"name": "Cube", "chosen": None, "tried": []})

    monkeypatch.setattr(gltf, "REPORT", [])
    monkeypatch.setattr(gltf_export, "write", write)
    report = tmp_path / "report.json"
    for options in ([], ["--gltf-error", "2%", "--report", str(report)]):
        assert cli.command(["--gltf", str(tmp_path / "a.glb"), *options]) == 0
    assert chosen[0] == (False, 0)
    assert chosen[1] == (True, pytest.approx(0.02))
    assert not scene.prt.gltf_compress
    assert json.loads(report.read_text())["gltf"] == gltf.REPORT


def refused(capsys, *arguments):
    """The one sentence that the command refuses ``arguments`` with."""
    assert cli.command([str(argument) for argument in arguments]) == 2
    error = capsys.readouterr().err
    assert error.startswith("prt_bake: ")
    assert "Traceback" not in error
    assert error.count("\n") == 1
    return error


def fail(error):
    """A bake that fails."""

    def job(*_arguments):
        yield Progress("transfer", 0.5)
        raise error

    return job


def test_it_bakes_what_is_selected_as_the_blend_says(scene, asked):
    scene.prt.rays, scene.prt.seed = 99, 7
    assert cli.command([]) == 0
    name, names, settings, world, target = asked[0]
    assert (name, names, world) == (scene.name, ["Lamp Shade"], None)
    assert target == Target("vertex", None, "Untitled")
    assert (settings.order, settings.rays, settings.seed, settings.threads) == (3, 99, 7, 0)
    assert settings.verify_points == 0


def test_options_go_before_the_blend(scene, asked):
    scene.prt.rays = 99
    scene.prt.quality, scene.prt.peaks = "TOLERANCE", 3
    line = "--order 5 --rays 32 --seed 3 --threads 1 --verify --no-residual --carrier vertex"
    line += " --visibility-order 3"
    assert cli.command([*line.split(), "--bounces", "0", "--peaks", "0", "--final-light"]) == 0
    settings = asked[0][2]
    assert (settings.order, settings.rays, settings.seed, settings.threads) == (5, 32, 3, 1)
    assert (settings.tolerance, settings.residual, settings.peaks) == (0, False, 0)
    assert settings.visibility_order == 3
    assert settings.final_light
    assert settings.verify_points > 0
    assert scene.prt.rays == 99, "the .blend's own settings stay"


def test_what_is_not_given_is_as_the_blend_says(scene, asked):
    chosen = scene.prt
    chosen.quality, chosen.tolerance, chosen.turns, chosen.peaks = "TOLERANCE", 2.0, 4, 1
    chosen.final_light, chosen.reflections, chosen.visibility_order = True, True, "4"
    assert cli.command([]) == 0
    settings = asked[0][2]
    assert settings.tolerance == pytest.approx(0.02)
    assert (settings.residual, settings.turns, settings.peaks) == (True, 4, 1)
    assert settings.final_light
    assert settings.visibility_order == 4
    assert cli.command(["--visibility-order", "0"]) == 0
    assert asked[1][2].visibility_order == 0


@pytest.mark.parametrize("words", ["0.01", "1%", "1 %"])
def test_an_error_is_a_fraction_or_a_percentage(asked, words):
    assert cli.command(["--tolerance", words]) == 0
    assert asked[0][2].tolerance == pytest.approx(0.01)


def test_turns_ask_for_the_residual(scene, asked):
    scene.prt.residual = False
    assert cli.command(["--turns", "12"]) == 0
    assert (asked[0][2].residual, asked[0][2].turns) == (True, 12)


def test_nothing_is_kept_when_nothing_shall_be(scene, asked):
    assert cli.command([]) == 0
    assert cli.command(["--no-cache"]) == 0
    assert [bool(call[2].cache) for call in asked] == [True, False]


def test_objects_are_baked_as_named_each_once(asked):
    names = ["Stool", "Lamp Shade", "Stool"]
    assert cli.command([word for name in names for word in ("--object", name)]) == 0
    assert asked[0][1] == ["Stool", "Lamp Shade"]


def test_an_unknown_object_is_answered_with_near_names(capsys, asked):
    assert "no object 'Stol': did you mean 'Stool'?" in refused(capsys, "--object", "Stol")
    assert "no object '../x'" in refused(capsys, "--object", "../x")
    assert asked == []


def test_the_world_is_found_from_where_the_command_is_given(asked, monkeypatch, tmp_path):
    monkeypatch.chdir(tmp_path)
    assert cli.command(["--world", "sky.exr"]) == 0
    assert asked[0][3] == str(tmp_path / "sky.exr")


def test_any_number_of_bounces_may_be_asked_for(capsys, asked):
    assert "--bounces: 'some' is no" in refused(capsys, "--bounces", "some")
    for words, bounces in (("2", 2), ("all", -1), ("0", 0)):
        assert cli.command(["--bounces", words]) == 0
        assert asked[-1][2].bounces == bounces


def test_direct_light_is_kept_apart_where_light_bounces(scene, capsys, asked):
    assert cli.command(["--keep-direct", "--bounces", "2"]) == 0
    assert asked[-1][2].keep_direct
    assert "Nothing bounces" not in capsys.readouterr().err
    assert cli.command(["--keep-direct"]) == 0
    assert "Nothing bounces, so all light is direct: --bounces says" in capsys.readouterr().err
    scene.prt.keep_direct = True
    for words, kept in (([], True), (["--no-keep-direct"], False)):
        assert cli.command(words) == 0
        assert asked[-1][2].keep_direct is kept


def test_textures_go_beside_the_saved_blend_or_where_they_are_told(scene, asked, tmp_path):
    scene.prt.carrier, scene.prt.resolution = "AUTO", "512"
    save = ["--save", str(tmp_path / "lit.blend")]
    for line, folder, settings in (
        ([], None, {"resolution": 512, "texel_density": 0.0, "shared_atlas": True}),
        (save, tmp_path, {}),
        ([*save, "--pack"], None, {}),
        ([*save, "--images", str(tmp_path / "maps")], tmp_path / "maps", {}),
        (["--resolution", "2048", "--half"], None, {"resolution": 2048, "half": True}),
        (["--texel-density", "4.5"], None, {"texel_density": 4.5}),
        (["--own-textures"], None, {"shared_atlas": False, "engine_images": ""}),
        (["--engine-images", "png"], None, {"engine_images": "png"}),
    ):
        assert cli.command(line) == 0
        target = asked[-1][4]
        assert (target.carrier, target.folder) == ("auto", folder)
        assert target.stem == ("lit" if line[:1] == ["--save"] else "Untitled")
        for name, value in settings.items():
            assert getattr(asked[-1][2], name) == value
    assert cli.command(["--carrier", "texture"]) == 0
    assert asked[-1][4].carrier == "texture"


def test_a_resolution_is_asked_for_in_powers_of_two(capsys, asked):
    assert "no power of two" in refused(capsys, "--resolution", "1000")
    assert "not allowed with" in refused(capsys, "--resolution", "64", "--texel-density", "3")


@pytest.mark.parametrize(
    "line",
    [
        "--order 1",
        "--order 6",
        "--order many",
        "--rays 15",
        "--rays 1e3",
        "--rays 64 --tolerance 0.01",
        "--seed -1",
        "--threads -1",
        "--tolerance 0",
        "--tolerance nan",
        "--tolerance 60%",
        "--tolerance 0.0001",
        "--tolerance one%",
        "--peaks 5",
        "--visibility-order 1",
        "--visibility-order 6",
        "--turns 0",
        "--turns 25",
        "--turns 2 --no-residual",
        "--carrier cloud",
        "--object",
        "--nonsense",
        "stray.blend",
        "--ord 3",
    ],
)
def test_a_bad_option_is_one_sentence(capsys, asked, line):
    refused(capsys, *line.split())
    assert asked == []


def test_help_lists_every_option_of_the_design(capsys):
    assert cli.command(["--help"]) == 0
    printed = capsys.readouterr().out
    line = "object world carrier resolution texel-density order bounces no-residual peaks rays"
    line += " tolerance turns final-light visibility-order no-cache seed threads save gltf report"
    line += " verify"
    assert all(f"--{option}" in printed for option in line.split())


def test_a_bake_error_is_2(capsys, cube, monkeypatch):
    monkeypatch.setattr(bake, "bake", fail(BakeError("The sky is missing")))
    assert cli.command([]) == 2
    assert capsys.readouterr().err.endswith("prt_bake: The sky is missing\n")


def test_a_bug_is_1_with_its_traceback(capsys, cube, monkeypatch):
    monkeypatch.setattr(bake, "bake", fail(ZeroDivisionError("ours")))
    assert cli.command([]) == 1
    assert "Traceback" in capsys.readouterr().err


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_an_interrupt_is_130_and_closes_the_job(capsys, cube, monkeypatch, number):
    closed = []

    def interrupt(*_arguments):
        try:
            yield Progress("transfer", 0.5)
            os.kill(os.getpid(), number)
            yield Progress("transfer", 0.6)
        finally:
            closed.append(True)

    monkeypatch.setattr(bake, "bake", interrupt)
    before = signal.getsignal(number)
    assert cli.command([]) == 130
    assert closed == [True]
    assert "interrupted" in capsys.readouterr().err
    assert signal.getsignal(number) == before


def test_an_interrupt_that_blender_swallows_is_130_too(capsys, cube, monkeypatch, tmp_path):
    """Blender prints what a handler or a class of ours raises, and goes on."""
    monkeypatch.setattr(gltf_export, "write", lambda path, _names: Path(path).write_bytes(b"glTF"))

    def swallow(*_arguments):
        yield Progress("transfer", 0.5)
        with contextlib.suppress(KeyboardInterrupt):
            os.kill(os.getpid(), signal.SIGINT)
        return {"objects": [], "notes": []}

    monkeypatch.setattr(bake, "bake", swallow)
    assert cli.command(["--gltf", str(tmp_path / "a.glb")]) == 130
    assert "interrupted" in capsys.readouterr().err
    assert list(tmp_path.iterdir()) == []


def test_an_interrupt_waits_while_blender_starts():
    with cli._Interrupts() as interrupts:
        with interrupts.held():
            os.kill(os.getpid(), signal.SIGINT)
        with pytest.raises(KeyboardInterrupt):
            interrupts.check()
        os.kill(os.getpid(), signal.SIGINT)  # again, while the first cleans up


def test_progress_goes_to_stderr_and_results_to_stdout(capsys, cube):
    assert cli.command(["--rays", "16"]) == 0
    printed = capsys.readouterr()
    assert "Tracing" in printed.err
    line = printed.out.splitlines()[-1]
    assert line.startswith("Lamp Shade: order 3, ")
    assert " points, 16 rays a point, " in line
    assert "Mrays/s, " in line
    assert " noise" in line
    assert line.endswith(", estimated")


@pytest.mark.parametrize("flag", ["-c", "--command"])
def test_what_blender_could_not_open_is_not_baked(scene, tmp_path, flag):
    line = ["blender", "-b", "Scene One.blend", flag, "prt_bake", "--save", "out.blend"]
    with pytest.raises(BakeError, match=r"^Scene One\.blend cannot be opened"):
        headless.check_opened(line)
    headless.check_opened(["blender", "-b", *line[3:]])
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "Scene One.blend"))
    headless.check_opened(line)
