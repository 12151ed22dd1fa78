"""An artist's way through the installed zip, in Debian's two Blenders (root: make real-blender).

The screenshots of a run stay below /tmp, named at its end, to be looked at.
"""

import json
import os
import subprocess
import sys
import time
from pathlib import Path

import pytest
from desktop import EXTENSION, RealBlender, crop, difference

ROOT = Path(__file__).parents[2]
BUTTON = (0.45, 50)  # of the sidebar's width, and pixels below its top: the middle of Bake PRT
VERSIONS = {"trixie": "4.3", "sid": "5.2"}


def make_zip(suite, folder):
    """The Linux zip; for sid one with wheels of its Python 3.14, for which xatlas has none."""
    package = [sys.executable, str(ROOT / "tools" / "package.py"), "--output", str(folder)]
    if suite == "sid":
        wheels = folder / "wheels"
        pins = [
            line.split()[1].split("-")[:2]
            for line in (ROOT / "tools" / "wheels.lock").read_text().splitlines()
        ]
        wanted = sorted({f"{name}=={version}" for name, version in pins if name != "xatlas"})
        pip = [sys.executable, "-m", "pip", "download", "-q", "--no-deps", "--dest", str(wheels)]
        target = ["--python-version", "3.14", "--only-binary", ":all:"]
        target += ["--platform", "manylinux_2_28_x86_64", "--platform", "manylinux_2_27_x86_64"]
        subprocess.run([*pip, *target, *wanted], check=True)
        package += ["--wheels", str(wheels)]
    subprocess.run(package, check=True)
    return next(folder.glob("prt_baker-*linux_x64.zip" if suite != "sid" else "prt_baker-*.zip"))


@pytest.fixture(scope="module", params=VERSIONS)
def blender(request):
    """A suite's Blender with the extension installed and its window open."""
    if os.geteuid() != 0:
        pytest.fail("A chroot needs root")
    real = RealBlender(request.param)
    if real.run("blender", "--version").returncode != 0:
        subprocess.run(real.chroot("setup"), check=True)
    zip_folder = real.folder / "zip"
    zip_folder.mkdir()
    path = make_zip(request.param, zip_folder)
    install = ["--command", "extension", "install-file", "-r", "user_default", "-e", path]
    installed = real.run("blender", *install)
    assert installed.returncode == 0, installed.stdout + installed.stderr
    yield real
    print(f"\nScreenshots: {real.folder}")


@pytest.fixture(scope="module")
def window(blender):
    """The open window, and the state before anything was baked."""
    try:
        blender.open()
        blender.ask("show")
        find_tab(blender)
        blender.ask("save")
        blender.ask("render")
        blender.settled("1 before", is_shaded)
        yield blender
    finally:
        blender.close()


def find_tab(window):
    """Turn the wheel with Ctrl over the sidebar until our tab is up."""
    window.settled("0 open")
    left, top, width, _ = window.state()["sidebar"]
    window.touch("mousemove", left + width - 12, top + 40)  # the strip of tabs
    for _ in range(12):
        if window.state()["tab"] == "PRT":
            return
        window.touch("keydown", "ctrl", "click", 5, "keyup", "ctrl")
        time.sleep(1)
    pytest.fail(f"There is no tab PRT, but {window.state()['tab']}")


def is_shaded(picture):
    """Whether Suzanne is of clay: she is white as long as EEVEE makes its shaders."""
    red, _, blue = picture[400:430, 630:660].mean((0, 1))
    return red > blue + 20


def differs(picture, other):
    """Whether the light is another one."""
    return difference(picture, other) > 1


def press_bake(window):
    """Click the Bake button and wait until it bakes."""
    left, top, width, _ = window.state()["sidebar"]
    window.click(int(left + BUTTON[0] * width), top + BUTTON[1])
    return window.wait(lambda state: state["fraction"] is not None, "a bake")


def bar(window, name):
    """The screen where the bar is."""
    left, top, width, _ = window.state()["sidebar"]
    return crop(window.screenshot(name), [left, top + 34, width, 34])


def test_this_is_the_blender_we_mean(blender):
    code = f"import sys; print('ENABLED', '{EXTENSION}' in sys.modules)"
    said = blender.run("blender", "--background", "--python-expr", code).stdout
    assert f"Blender {VERSIONS[blender.suite]}." in said
    assert "ENABLED True" in said


def test_the_button_bakes_while_the_bar_moves_and_the_viewport_shows_it(window):
    before = window.canvas(window.screenshot("1 before"))
    press_bake(window)
    early = bar(window, "2 bar")
    fraction = window.state()["fraction"]
    window.wait(lambda state: (state["fraction"] or 0) > fraction + 0.2, "the bar")
    later = bar(window, "3 bar later")
    assert window.state()["fraction"] is not None
    assert difference(later, early) > 1
    state = window.wait(lambda state: state["fraction"] is None, "the end of the bake", 600)
    assert sorted(state["baked"]) == ["Cylinder", "Grid", "Suzanne"]
    window.settled("4 baked", lambda now: is_shaded(now) and differs(window.canvas(now), before))


def test_escape_leaves_the_scene_as_it_was(window):
    window.ask("reseed")
    before = window.state()
    assert before["baked"]
    press_bake(window)
    window.wait(lambda state: (state["fraction"] or 0) > 0.1, "the middle of the bake")
    window.touch("key", "Escape")
    after = window.wait(lambda state: state["fraction"] is None, "the end of the bake", 10)
    assert after["scene"] == before["scene"]
    assert list(window.temporary.glob("prt-job-*")) == []


def test_the_viewport_follows_the_turned_world(window):
    before = window.canvas(window.settled("5 before the turn"))
    window.ask("turn")
    window.settled("6 turned", lambda now: differs(window.canvas(now), before))


def command(blender, scene, *options):
    """Bake on the command line, as on a farm."""
    return blender.run("blender", "--background", scene, "--command", "prt_bake", *options)


def test_the_command_bakes_and_exits_0(window):
    folder = window.folder
    outputs = ["--save", folder / "baked.blend", "--gltf", folder / "baked.glb"]
    options = ["--rays", 64, "--report", folder / "report.json", *outputs]
    result = command(window, folder / "scene.blend", *options)
    assert result.returncode == 0, result.stdout + result.stderr
    report = json.loads((folder / "report.json").read_text())
    assert len(report["objects"]) == 3
    assert (folder / "baked.blend").stat().st_size > (folder / "scene.blend").stat().st_size
    assert (folder / "baked.glb").read_bytes()[:4] == b"glTF"


@pytest.mark.parametrize(
    ("scene", "options"),
    [
        ("no world.blend", []),
        ("scene.blend", ["--world", "missing.exr"]),
        ("scene.blend", ["--world", "broken.exr"]),
        ("scene.blend", ["--object", "Nobody"]),
        ("scene.blend", ["--order", 9]),
    ],
)
def test_the_command_says_one_sentence_and_exits_2(window, scene, options):
    (window.folder / "broken.exr").write_bytes(b"\x76\x2f\x31\x01" + bytes(range(200)))
    options = [window.folder / o if str(o).endswith(".exr") else o for o in options]
    result = command(window, window.folder / scene, *options)
    assert result.returncode == 2, result.stdout + result.stderr
    assert "Traceback" not in result.stderr
