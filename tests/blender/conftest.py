"""An empty file for every test, with the add-on registered."""

import os
import tempfile
from collections.abc import Iterator
from pathlib import Path

import bpy
import pytest

# Mesa's anisotropic filter on the processor is a blur: without it textures are read as numpy does
EXACT_FILTER = "-GL_EXT_texture_filter_anisotropic -GL_ARB_texture_filter_anisotropic"
os.environ.setdefault("MESA_EXTENSION_OVERRIDE", EXACT_FILTER)


@pytest.fixture
def scene(
    registered: None, tmp_path_factory: pytest.TempPathFactory, monkeypatch: pytest.MonkeyPatch
) -> bpy.types.Scene:
    """The scene of an empty file, without a world; nothing that was traced is kept from another
    test."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path_factory.mktemp("cache")))
    bpy.ops.wm.read_factory_settings(use_empty=True)
    return bpy.context.scene


@pytest.fixture
def temporary(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """The folder for jobs, which each of them leaves empty."""
    folder = tmp_path / "temporary"
    folder.mkdir()
    monkeypatch.setattr(tempfile, "tempdir", str(folder))
    yield folder
    assert list(folder.iterdir()) == []
