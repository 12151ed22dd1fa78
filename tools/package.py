"""Builds the extension's zips, one a platform, with the builder that comes with Blender's wheel.

    python tools/package.py [--output FOLDER] [--wheels FOLDER]

Only files that git tracks go in, from a folder of their own, so nothing of a working copy slips
into a zip.  ``--wheels`` replaces the manifest's wheels by those of a folder, for a Blender whose
Python the manifest does not serve: such a zip is for tests alone and is not split.
"""

import argparse
import importlib.util
import re
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

ROOT = Path(__file__).parents[1]
MANIFEST = "blender_manifest.toml"


def blender_ext() -> Path:
    """Blender's own program for extensions, which needs no Blender to run."""
    spec = importlib.util.find_spec("bpy")
    if spec is None or spec.origin is None:
        sys.exit("Blender's wheel is missing: run make venv")
    found = Path(spec.origin).parent.glob("*/scripts/addons_core/bl_pkg/cli/blender_ext.py")
    return next(found)


def stage(folder: Path, wheels: Path) -> None:
    """Copy what git tracks, and the wheels, into an empty ``folder``."""
    command = ["git", "ls-files", "-z"]
    names = subprocess.run(command, cwd=ROOT, check=True, capture_output=True, text=True).stdout
    for name in filter(lambda name: (ROOT / name).is_file(), names.split("\0")):
        target = folder / name
        target.parent.mkdir(parents=True, exist_ok=True)
        shutil.copyfile(ROOT / name, target)
    (folder / "wheels").symlink_to(wheels.resolve())


def name_wheels(manifest: Path, wheels: Path) -> None:
    """Make ``manifest`` list the wheels of a folder, for this platform alone."""
    lines = "".join(f'    "./wheels/{wheel.name}",\n' for wheel in sorted(wheels.glob("*.whl")))
    text = re.sub(r"(?ms)^wheels = \[.*?^\]", f"wheels = [\n{lines}]", manifest.read_text("utf-8"))
    manifest.write_text(re.sub(r"(?m)^platforms = .*$", "", text), "utf-8")


def build(output: Path, wheels: Path | None = None) -> list[Path]:
    """Build and validate the zips in ``output``; the zips."""
    output.mkdir(parents=True, exist_ok=True)
    program = [sys.executable, str(blender_ext())]
    split = ["--split-platforms"] if wheels is None else []
    with tempfile.TemporaryDirectory(prefix="prt-baker-stage-") as staging:
        source = Path(staging)
        stage(source, wheels or ROOT / "wheels")
        if wheels:
            name_wheels(source / MANIFEST, wheels)
        where = ["--source-dir", staging, "--output-dir", str(output.resolve())]
        subprocess.run([*program, "build", *split, *where], check=True)
    zips = sorted(output.glob("prt_baker-*.zip"))
    for path in zips:
        subprocess.run([*program, "validate", str(path)], check=True)
    return zips


def main() -> None:
    """Build into dist/, emptied of older zips."""
    parser = argparse.ArgumentParser(description="Build the extension's zips")
    parser.add_argument("--output", type=Path, default=ROOT / "dist")
    parser.add_argument("--wheels", type=Path)
    arguments = parser.parse_args()
    for old in arguments.output.glob("prt_baker-*.zip"):
        old.unlink()
    for path in build(arguments.output, arguments.wheels):
        print(f"{path.name}: {path.stat().st_size / 1e6:.1f} MB")


if __name__ == "__main__":
    main()
