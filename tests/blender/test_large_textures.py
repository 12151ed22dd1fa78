"""A scene into a texture from beginning to end: signs of life all the while, and Esc at any time.

``make large`` does it with 100,000 faces and 2048 x 2048 texels.
"""

import os
import time
from contextlib import closing

import bpy
import numpy as np
import pytest
import snapshot
from bakes import place, principled
from prt_baker.addon import bake
from prt_baker.addon.atlas_files import Target
from prt_baker.addon.prt.job import Settings
from worlds import environment, generated, picture

SIZE, QUADS = (2048, 317) if os.environ.get("PRT_LARGE") else (512, 64)  # texels; a side
LONGEST = 2.0  # seconds between two signs of life
SETTINGS = Settings(rays=64, seed=5, resolution=SIZE)


pytestmark = pytest.mark.usefixtures("temporary")


@pytest.fixture
def sheet(scene):
    """A sheet with bumps that shade each other, under a sky."""
    environment(scene, generated(picture()))
    x, y = (
        axis.reshape(-1)
        for axis in np.meshgrid(*2 * [np.linspace(-1, 1, QUADS + 1)], indexing="ij")
    )
    places = np.stack([x, y, 0.1 * np.sin(17 * x) * np.cos(13 * y)], axis=1)
    first = (np.arange(QUADS)[:, None] * (QUADS + 1) + np.arange(QUADS)).reshape(-1)
    faces = first[:, None] + np.array([0, QUADS + 1, QUADS + 2, 1])
    mesh = bpy.data.meshes.new("Sheet")
    mesh.from_pydata(places.tolist(), [], faces.tolist())
    mesh.shade_smooth()
    mesh.materials.append(principled())
    return place(scene, mesh, 0, 0)


def steps_of(scene, obj, folder):
    return bake.bake(scene.name, [obj.name], SETTINGS, target=Target("texture", folder, "sheet"))


def test_there_are_signs_of_life_all_the_while(scene, sheet, tmp_path, record_property):
    """Of the engine, which says something new, and of Blender, which draws between two steps."""
    pauses, frozen = {}, {}
    last = drawn = time.perf_counter()
    seen = None
    for step in steps_of(scene, sheet, tmp_path):
        now = time.perf_counter()
        frozen[step.phase] = max(frozen.get(step.phase, 0.0), now - drawn)
        drawn = now
        if step != seen:
            pauses[step.phase] = max(pauses.get(step.phase, 0.0), now - last)
            last, seen = now, step
    frozen["written"] = time.perf_counter() - drawn
    record_property("pauses", pauses)
    record_property("frozen", frozen)
    assert {"unwrap", "transfer", "fill"} <= set(pauses)
    assert max(pauses.values()) < LONGEST
    assert max(frozen.values()) < LONGEST


@pytest.mark.parametrize("phase", ["unwrap", "transfer", "fill"])
def test_esc_leaves_everything_as_it_was(scene, sheet, tmp_path, phase):
    before = snapshot.of(scene), set(bpy.data.images), sorted(tmp_path.iterdir())
    with closing(steps_of(scene, sheet, tmp_path)) as steps:
        while next(steps).phase != phase:
            pass
        since = time.perf_counter()
    assert time.perf_counter() - since < 1
    assert (snapshot.of(scene), set(bpy.data.images), sorted(tmp_path.iterdir())) == before
    assert [layer.name for layer in sheet.data.uv_layers] == []
