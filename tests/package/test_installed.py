"""The zip as an artist has it: installed in a Blender where nothing of ours is in Python's path."""

import json
import os
import subprocess
import sysconfig
import venv
from pathlib import Path

import pytest

OURS = ("embreex", "openexr", "xatlas", "prt_baker", "__editable__")
SCRIPT = Path(__file__).with_name("installed_bake.py")


@pytest.fixture(scope="module")
def bare_python(tmp_path_factory) -> Path:
    """A Python with Blender's wheel and what that needs, but without our native packages."""
    folder = tmp_path_factory.mktemp("bare")
    venv.create(folder, symlinks=True)
    site = folder / "lib" / f"python{sysconfig.get_python_version()}" / "site-packages"
    for entry in Path(sysconfig.get_path("purelib")).iterdir():
        if not entry.name.lower().startswith(OURS):
            (site / entry.name).symlink_to(entry)
    return folder / "bin" / "python"


@pytest.fixture(scope="module")
def outcome(bare_python, zips, tmp_path_factory):
    """What tests/package/installed_bake.py says of the installed zip."""
    resources = tmp_path_factory.mktemp("resources")
    result = subprocess.run(
        [bare_python, SCRIPT, zips["linux-x64"]],
        env={
            **os.environ,
            "BLENDER_USER_RESOURCES": str(resources),
            "PYTHONPATH": "",
            "TMPDIR": str(tmp_path_factory.mktemp("temporary")),
        },
        capture_output=True,
        text=True,
        check=False,
    )
    assert result.returncode == 0, result.stdout + result.stderr
    said = json.loads(result.stdout.splitlines()[-1])
    return said | {"resources": str(resources)}


def test_the_installed_extension_bakes_with_its_own_wheels(outcome):
    assert all(path.startswith(outcome["resources"]) for path in outcome["native"])
    assert outcome["result"] == ["FINISHED"]
    assert outcome["attributes"] == ["_PRT_0", "_PRT_1", "_PRT_2"]
    assert outcome["light"]
    assert outcome["engine_left"] == []


def test_the_add_on_folder_is_not_written_to(outcome):
    assert outcome["new_files"] == []


def test_disabling_takes_everything_away(outcome):
    assert outcome["after"] == {"operators": [], "settings": False, "handlers": []}
