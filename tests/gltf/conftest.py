"""An empty file, and objects baked in it with made-up transfer, so that a mistake shows."""

import bpy
import numpy as np
import pytest
from gltf_bakes import bake_by_hand
from prt_baker.addon import light_state
from prt_baker.addon.prt.job import Peak
from viewer_page import Page

PEAKS = (Peak((0.6, 0.0, 0.8), (30.0, 20.0, 10.0), 0.1), Peak((0.0, -1.0, 0.0), (1, 2, 3), 0.0))


@pytest.fixture
def scene():
    """The scene of an empty file, with a light."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    rng = np.random.default_rng(5)
    now, baked = rng.normal(size=(2, 25, 3))
    state = light_state.LightState("key", baked, now, baked, peaks=PEAKS)
    light_state.write(bpy.context.scene, state)
    return bpy.context.scene


@pytest.fixture
def bake(scene):
    """Bakes made-up values; returns the transfer (E, channels, n²) of the object's elements."""
    return bake_by_hand


@pytest.fixture
def out(tmp_path):
    return tmp_path / "scene.glb"


@pytest.fixture(scope="session")
def page():
    """The viewer in a browser, one for all tests."""
    found = Page()
    yield found
    found.close()
