"""Where traced values are kept between bakes and between sessions of Blender."""

import os
import sys
from pathlib import Path

import bpy

PACKAGE = __package__.rpartition(".")[0]  # the add-on, wherever it is installed
NAME = "prt-baker"


def path() -> str:
    """The folder, made where it was not there; "" where none can be made: then nothing is kept."""
    try:
        if PACKAGE.startswith("bl_ext."):
            return bpy.utils.extension_path_user(PACKAGE, path="cache", create=True)
        folder = _of_the_platform() / NAME
        folder.mkdir(parents=True, exist_ok=True)
    except (OSError, RuntimeError):  # a disk without room or rights, a user without a home
        return ""
    return str(folder)


def _of_the_platform() -> Path:
    """The user's folder for what can be made again."""
    if sys.platform == "win32":
        return Path(os.environ.get("LOCALAPPDATA") or Path.home() / "AppData" / "Local")
    if sys.platform == "darwin":
        return Path.home() / "Library" / "Caches"
    given = Path(os.environ.get("XDG_CACHE_HOME", ""))
    return given if given.is_absolute() else Path.home() / ".cache"
