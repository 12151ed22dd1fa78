"""An empty file for every test, with the add-on registered."""

import atexit
from collections.abc import Iterator

import bpy
import prt_baker
import pytest


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
