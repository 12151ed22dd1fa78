"""Installed packages, looked up without loading them or all that ``importlib.metadata`` loads."""

from importlib.util import find_spec
from pathlib import Path


def home(package: str) -> Path | None:
    """The folder that a ``package`` is found in; None where there is none."""
    spec = find_spec(package)
    if spec is None or spec.origin is None:
        return None
    origin = Path(spec.origin)
    return origin.parent.parent if origin.stem == "__init__" else origin.parent


def wheel_version(package: str) -> str:
    """What a ``package`` says of itself in the folder beside it, "unknown" where nothing."""
    folder = home(package)
    for its in folder.glob("*.dist-info") if folder else ():
        name, _, version = its.stem.partition("-")
        if name.lower() == package.lower():
            return version
    return "unknown"
