"""An empty file for every test, with the add-on registered."""

import atexit
import os
from collections.abc import Iterator

import bpy
import prt_baker
import pytest

# Mesa's anisotropic filter on the processor is a blur: without it textures are read as numpy does
EXACT_FILTER = "-GL_EXT_texture_filter_anisotropic -GL_ARB_texture_filter_anisotropic"
os.environ.setdefault("MESA_EXTENSION_OVERRIDE", EXACT_FILTER)


@pytest.fixture(scope="session")
def registered() -> Iterator[None]:
    """The add-on, switched on; Blender hangs or dies at exit with our classes still registered."""
    prt_baker.register()
    done = []

    def unregister() -> None:
        if not done:
            done.append(True)
            prt_baker.unregister()

    atexit.register(unregister)
    yield
    unregister()


@pytest.fixture
def scene(
    registered: None, tmp_path_factory: pytest.TempPathFactory, monkeypatch: pytest.MonkeyPatch
) -> bpy.types.Scene:
    """The scene of an empty file, without a world; nothing that was traced is kept from another
    test."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path_factory.mktemp("cache")))
    bpy.ops.wm.read_factory_settings(use_empty=True)
    return bpy.context.scene
