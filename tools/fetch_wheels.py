"""Fetches the wheels of the extension's zips into wheels/, checked against tools/wheels.lock.

    python tools/fetch_wheels.py

The lock is what ``sha256sum *.whl`` prints; a wheel that is already there and right is kept.
"""

import hashlib
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).parents[1]
LOCK = ROOT / "tools" / "wheels.lock"
WHEELS = ROOT / "wheels"


def locked() -> dict[str, str]:
    """The wheels that the zips hold: file name to sha256."""
    lines = LOCK.read_text("ascii").splitlines()
    return {name: digest for digest, name in (line.split() for line in lines)}


def is_right(wheel: Path, digest: str) -> bool:
    """Whether ``wheel`` is there and is the locked one."""
    return wheel.is_file() and hashlib.sha256(wheel.read_bytes()).hexdigest() == digest


def download(wheel: Path) -> None:
    """Fetch one wheel for the platform in its name, whatever platform this is."""
    name, version, python, abi, platforms = wheel.stem.split("-")
    target = ["--implementation", python[:2], "--python-version", python[2:], "--abi", abi]
    for platform in platforms.split("."):
        target += ["--platform", platform]
    pip = [sys.executable, "-m", "pip", "download", "--quiet", "--disable-pip-version-check"]
    what = ["--no-deps", "--only-binary", ":all:", "--dest", str(wheel.parent)]
    subprocess.run([*pip, *what, *target, f"{name}=={version}"], check=True)


def main() -> None:
    """Fetch what is missing; exit with a sentence on a wheel that is not the locked one."""
    WHEELS.mkdir(exist_ok=True)
    for name, digest in locked().items():
        wheel = WHEELS / name
        if is_right(wheel, digest):
            continue
        wheel.unlink(missing_ok=True)
        download(wheel)
        if not is_right(wheel, digest):
            wheel.unlink(missing_ok=True)
            sys.exit(f"{name} is not the wheel that {LOCK.name} names")
        print(f"{name}: ok", flush=True)


if __name__ == "__main__":
    main()
