"""A machine without Blender's libraries: root installs them, anyone else gets the exact line."""

import os
import subprocess
import sys
from pathlib import Path

import pytest


@pytest.fixture
def bare_machine(root, tmp_path):
    """Run tools/system_packages.sh where no library is found, as user ``uid``."""

    def run(uid, libraries="", *wanted):
        programs = {
            "ldconfig": f"cat {tmp_path}/libraries",
            "id": f"echo {uid}",
            "apt-get": f'echo "$@" >> {tmp_path}/apt',
        }
        (tmp_path / "libraries").write_text(libraries)
        for name, line in programs.items():
            (tmp_path / name).write_text(f"#!/bin/sh\n{line}\n")
            (tmp_path / name).chmod(0o755)
        path = f"{tmp_path}:{os.environ['PATH']}"
        return subprocess.run(
            [root / "tools" / "system_packages.sh", sys.executable, *wanted],
            env={**os.environ, "PATH": path},
            capture_output=True,
            text=True,
            check=False,
        )

    return run


def test_a_user_gets_the_line_and_exit_2(bare_machine, tmp_path):
    result = bare_machine(uid=1000)
    assert result.returncode == 2
    line = result.stderr.splitlines()[-1].split()
    assert line[:5] == ["sudo", "apt-get", "install", "-y", "--no-install-recommends"]
    assert {"libx11-6", "libegl1", "libgl1"} < set(line[5:])
    assert not (tmp_path / "apt").exists()


def test_root_installs(bare_machine, tmp_path):
    assert bare_machine(uid=0).returncode == 0
    update, install = (tmp_path / "apt").read_text().splitlines()
    assert update == "update -qq"
    assert "libegl1" in install.split()


def test_only_what_is_missing_is_named(bare_machine):
    everything = subprocess.run(
        ["ldconfig", "-p"],
        env={**os.environ, "PATH": f"{os.environ['PATH']}:/sbin:/usr/sbin"},
        capture_output=True,
        text=True,
        check=True,
    ).stdout
    without = "\n".join(line for line in everything.splitlines() if "libEGL.so.1 " not in line)
    assert bare_machine(uid=1000, libraries=everything).returncode == 0
    assert bare_machine(uid=1000, libraries=without).stderr.split()[-1] == "libegl1"


def test_the_tests_want_a_browser_too(bare_machine, tmp_path, monkeypatch):
    programs = tmp_path / "programs"
    programs.mkdir()
    for path in {**by_name("/bin"), **by_name("/usr/bin")}.values():
        if "chrom" not in path.name:
            (programs / path.name).symlink_to(path)
    monkeypatch.setenv("PATH", str(programs))
    assert "chromium" not in bare_machine(1000).stderr
    assert bare_machine(1000, "", "browser").stderr.split()[-1] == "chromium"
    (programs / "chromium").symlink_to("/bin/true")
    assert "chromium" not in bare_machine(1000, "", "browser").stderr


def by_name(folder):
    return {path.name: path for path in Path(folder).iterdir()}
