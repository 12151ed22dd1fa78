"""What artists get: the zips hold the listed files and wheels, and nothing else."""

import importlib.util
import tomllib
import zipfile
from pathlib import Path

import pytest
from prt_baker.addon.prt import VERSION

ROOT = Path(__file__).parents[2]
CODE = Path(__file__).with_name("contents.txt").read_text("utf-8").split()
SYSTEMS = {
    "linux-x64": ("manylinux", "x86_64"),
    "windows-x64": ("win", "amd64"),
    "macos-arm64": ("macosx", "arm64"),
    "macos-x64": ("macosx", "x86_64"),
}


@pytest.fixture(scope="module")
def manifest():
    return tomllib.loads((ROOT / "blender_manifest.toml").read_text("utf-8"))


def wheels_of(manifest, platform):
    system, machine = SYSTEMS[platform]
    names = [wheel.removeprefix("./") for wheel in manifest["wheels"]]
    return {n for n in names if f"-{system}" in n and n.endswith(f"{machine}.whl")}


def test_one_zip_for_each_platform(zips, manifest):
    assert set(zips) == set(manifest["platforms"]) == set(SYSTEMS)


@pytest.mark.parametrize("platform", SYSTEMS)
def test_a_zip_holds_the_listed_files_and_its_own_wheels(zips, manifest, platform):
    with zipfile.ZipFile(zips[platform]) as file:
        names = file.namelist()
        assert file.testzip() is None
    assert len(names) == len(set(names))
    assert set(names) == {"blender_manifest.toml", *CODE, *wheels_of(manifest, platform)}


@pytest.mark.parametrize("platform", SYSTEMS)
def test_both_pythons_get_every_native_package(manifest, platform):
    wheels = [name.split("/")[1].split("-") for name in wheels_of(manifest, platform)]
    packages = [(name, python, abi) for name, _, python, abi, _ in wheels]
    assert sorted(packages) == [
        (name, python, python)
        for name in ("embreex", "openexr", "xatlas")
        for python in ("cp311", "cp313")
    ]


def test_wheels_are_the_locked_ones_at_the_versions_we_test_with(manifest):
    lock = [line.split()[1] for line in (ROOT / "tools" / "wheels.lock").read_text().splitlines()]
    assert manifest["wheels"] == [f"./wheels/{name}" for name in lock]
    pins = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))["project"]["dependencies"]
    versions = {tuple(pin.lower().split("==")) for pin in pins}
    assert {tuple(name.split("-")[:2]) for name in lock} < versions


def test_one_version_everywhere(manifest):
    assert manifest["version"] == VERSION
    assert f"\n## {VERSION}\n" in (ROOT / "CHANGELOG.md").read_text("utf-8")


def test_permissions_are_short_reasons(manifest):
    for reason in (manifest["tagline"], *manifest["permissions"].values()):
        assert 0 < len(reason) <= 64
        assert reason[-1].isalnum()


@pytest.fixture
def fetch():
    """tools/fetch_wheels.py as a module."""
    spec = importlib.util.spec_from_file_location(
        "fetch_wheels", ROOT / "tools" / "fetch_wheels.py"
    )
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_a_wheel_that_is_not_the_locked_one_is_refused(fetch, tmp_path, monkeypatch):
    monkeypatch.setattr(fetch, "WHEELS", tmp_path)
    monkeypatch.setattr(fetch, "locked", lambda: {"a-1-cp313-cp313-win_amd64.whl": "0" * 64})
    monkeypatch.setattr(fetch, "download", lambda wheel: wheel.write_bytes(b"something else"))
    with pytest.raises(SystemExit, match="is not the wheel"):
        fetch.main()
    assert list(tmp_path.iterdir()) == []
