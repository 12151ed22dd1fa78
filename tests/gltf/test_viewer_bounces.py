"""The viewer's switch for bounces: pixels without them are what numpy makes of the .blend's direct
light, and the switch is there only where a file has that."""

from pathlib import Path

import bpy
import numpy as np
import pytest
from gltf_scenes import mirrored, monkey, rotated
from gltf_textured import bake_in_texture
from gltf_validator import assert_valid
from gltf_worlds import hdri
from prt_baker.addon import bake as baking
from prt_baker.addon import gltf_export, gltf_panel
from prt_baker.addon.prt.job import Settings
from prt_baker.addon.prt.layout import Layout
from test_viewer_page import HELPERS
from test_viewer_pixels import OPEN, nearly_baked_light, painted, see
from viewer_laws import encoded, expected


def on_vertices(bake):
    """One of colours and peaks on corners, one of modifiers, and one without bounces."""
    first, second, third = painted(mirrored()), monkey("Second"), rotated()
    second.modifiers.new("Subdivision", "SUBSURF")
    second.location.x, third.location.x = -3, 4
    bake(
        first, channels=3, turns=1, lights=2, domain="CORNER", seen=2, smooth=True, direct=True
    )  # fmt: skip
    bake(second, turns=12, by_modifier=True, smooth=True, direct=True)
    bake(third, turns=12, smooth=True)
    return [first, second, third]


def short(bake):
    bpy.context.scene.prt.gltf_short = True
    return on_vertices(bake)


def many(bake):
    """More attributes in all than WebGL has: 13 and 5, with the position."""
    obj = monkey()
    bake(obj, order=4, channels=3, turns=1, smooth=True, direct=True)
    return [obj]


def textured(bake):
    first, second = painted(mirrored()), monkey("Second")
    second.location.x = 3
    second.data.materials.append(bpy.data.materials["Painted"])
    layout = Layout(3, channels=3, turns=1, lights=1)
    folder = Path(bpy.app.tempdir)
    bake_in_texture(folder, [first, second], layout, size=128, direct=True)
    return [first, second]


def real(bake):
    """By the engine, a monkey over a red floor."""
    hdri(bpy.context.scene, "sunset")
    bpy.ops.mesh.primitive_grid_add(
        x_subdivisions=20, y_subdivisions=20, size=6, location=(0, 0, -1)
    )
    objects = [painted(bpy.context.object), monkey()]
    settings = Settings(rays=32, peaks=1, residual=True, bounces=2, keep_direct=True)
    for _ in baking.bake(bpy.context.scene.name, [obj.name for obj in objects], settings):
        pass
    return objects


SCENES = {f.__name__.replace("_", " "): f for f in (on_vertices, short, many, textured, real)}


@pytest.mark.parametrize("make", SCENES.values(), ids=SCENES)
@pytest.mark.usefixtures("registered")
def test_pixels_without_bounces_are_those_of_the_blend(scene, bake, page, out, make):
    nearly_baked_light(scene)
    objects = make(bake)
    bpy.context.view_layer.update()
    gltf_export.write(str(out))
    assert_valid(out)
    camera = page.run(OPEN, glb=out)
    assert camera["problems"] == []
    assert camera["baked"] == len(objects)
    for environment, model in ((0, 0), (77, 40)):
        pixels, whole = expected(objects, camera, environment, model)
        _, direct = expected(objects, camera, environment, model, bounces=False)
        assert len(pixels) > 40
        assert np.abs(whole - direct).max() > 0.05
        for bounces, truth in ((True, whole), (False, direct)):
            floats, bytes8 = see(page, pixels, environment, model, bounces=bounces)
            np.testing.assert_allclose(floats, truth, rtol=1e-3, atol=1e-3)
            assert np.abs(bytes8 - encoded(truth)).max() <= 1


def test_clusters_have_their_own_without_bounces(registered, scene, bake, page, out):
    nearly_baked_light(scene)
    obj = painted(mirrored())
    obj.modifiers.new("Subdivision", "SUBSURF").levels = 2
    bake(obj, turns=1, by_modifier=True, smooth=True, bent=True, direct=True)
    with gltf_panel.chosen(scene, None, 0.01):
        gltf_export.write(str(out))
    assert_valid(out)
    camera = page.run(OPEN, glb=out)
    assert camera["problems"] == []
    for bounces in (True, False):
        pixels, truth = expected([obj], camera, bounces=bounces)
        floats, _ = see(page, pixels, bounces=bounces)
        assert np.sqrt(np.square(floats - truth).mean() / np.square(truth).mean()) < 0.02


SWITCH = """
    set('bounces', true);
    await viewer.open('a.glb', files.glb);
    const shown = $('#bounces').checkVisibility(), { bounces: before } = stage.options;
    set('bounces', false);
    const { bounces: after } = stage.options, [one] = stage.primitives;
    const material = one.mesh.material === one.direct?.baked;
    set('bounces', true);
    return [shown, before, after, material, one.mesh.material === one.baked];
"""


@pytest.mark.parametrize("direct", [True, False])
def test_the_switch_is_there_where_a_file_has_both(scene, bake, page, out, direct):
    bake(monkey(), turns=1, direct=direct)
    gltf_export.write(str(out))
    assert page.run(HELPERS + SWITCH, glb=out) == [direct, True, False, direct, True]


def test_the_difference_to_the_plain_material_follows_the_switch(scene, bake, page, out):
    nearly_baked_light(scene)
    bake(painted(monkey()), turns=1, smooth=True, direct=True)
    gltf_export.write(str(out))
    body = """
        const { stage } = viewer;
        await stage.loadModel(files.glb);
        stage.resize(64, 48);
        stage.show('error');
        const seen = [true, false].map((bounces) => {
          stage.set({ bounces });
          return Array.from(stage.readBytes());
        });
        stage.show('baked');
        stage.set({ bounces: true });
        return seen;
    """
    on, off = np.array(page.run(body, glb=out))
    assert np.abs(on - off).max() > 10
