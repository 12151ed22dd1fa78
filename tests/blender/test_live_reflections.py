"""Another HDRI lights at once and is reflected a little later; renders wait for it."""

import bpy
import numpy as np
import pytest
from bakes import constant_bake, principled, quad
from pictures import look_down
from prt_baker.addon import (
    engine,
    light_state,
    live_light,
    live_reflections,
    nodes,
    reflections,
    world,
    writeback,
)
from prt_baker.addon.light_state import LightState
from prt_baker.addon.prt.errors import BakeError
from prt_baker.addon.prt.files import images
from prt_baker.addon.prt.job import Settings
from prt_baker.addon.prt.layout import Layout
from prt_baker.addon.prt.light import projection
from prt_baker.addon.prt.results import Reflections
from prt_baker.addon.prt.specular import sheet
from worlds import environment, generated, picture


@pytest.fixture
def texture(scene, tmp_path):
    """The world's Environment Texture, which is baked and reflected by a metal."""
    texture = environment(scene, generated(picture()))["texture"]
    obj = quad(scene, material=principled(Metallic=1, Roughness=0.5))
    got = world.read_nodes(scene, bpy.context.evaluated_depsgraph_get())
    image_sh = projection.project(world.source(got, tmp_path)).image_sh
    its_sheet, values = sheet.make(picture(), cell=(80, 40))
    path = tmp_path / "reflections.exr"
    images.write_rgba(str(path), values[::-1], half=True)
    with reflections.loaded(Reflections(its_sheet, (), path=path), got.image_key) as image:
        writeback.write(scene, [constant_bake(obj, Layout(3))], Layout(3), (), image)
    radiance = projection.world_sh(image_sh, got.strength, got.rotation)
    state = LightState(
        got.image_key, image_sh, radiance, radiance, True, (), got.rotation, got.strength
    )
    live_light.show(scene, state)
    bpy.context.view_layer.update()
    return texture


@pytest.fixture
def window(monkeypatch):
    """As if there were one; no timer fires, so tests tick themselves."""
    monkeypatch.setattr(live_reflections, "must_wait", lambda: False)
    yield
    live_reflections.stop()


def swap(texture, seed):
    """Another picture in the world."""
    texture.image = generated(picture(seed), f"Picture {seed}")
    bpy.context.view_layer.update()


def reflected_up():
    """What a rough metal that faces up reflects, of the picture, at a strength of 1."""
    image = reflections.current()
    width, height = image.size
    pixels = np.array(image.pixels[:]).reshape(height, width, 4)
    towards = np.array([[0.0, 0, 1]])
    return sheet.radiance(reflections.of(image).sheet, pixels, towards, 0.6)[0]


def ticked():
    """Tick until it is over; how often."""
    ticks = 0
    while live_reflections._tick() is not None:
        ticks += 1
    return ticks


def test_the_light_follows_at_once_and_what_is_reflected_later(scene, texture, window):
    before, sharp = light_state.read(scene).radiance_sh, reflected_up()
    swap(texture, 1)
    assert np.abs(light_state.read(scene).radiance_sh - before).max() > 0.1
    np.testing.assert_array_equal(reflected_up(), sharp)
    assert bpy.app.timers.is_registered(live_reflections._tick)
    assert ticked() > 0
    assert reflected_up()[0] > sharp[0] + 0.2
    image = reflections.current()
    assert reflections.of(image).key == light_state.read(scene).image_key
    (tree,) = nodes.groups()
    assert {node.image for node in tree.nodes if node.type == "TEX_IMAGE"} == {image}
    assert not writeback.set_light(light_state.read(scene)), "the new scale is shown"


def test_the_last_of_several_is_reflected(scene, texture, window, monkeypatch):
    jobs, run = [], engine.run
    monkeypatch.setattr(engine, "run", lambda job, folder: jobs.append(job) or run(job, folder))
    for seed in (1, 2, 1, 3):
        swap(texture, seed)
    ticked()
    assert reflected_up()[0] > 1.5
    assert sum(job.settings.reflections for job in jobs) == 1
    texture.image.update_tag()
    bpy.context.view_layer.update()
    assert ticked() == 0


def test_back_to_what_is_reflected_needs_nothing(texture, window):
    first, before = texture.image, reflected_up()
    swap(texture, 1)
    texture.image = first
    bpy.context.view_layer.update()
    live_reflections.finish()
    np.testing.assert_array_equal(reflected_up(), before)


def test_a_render_waits_and_another_file_does_not(scene, texture, window, tmp_path):
    before = reflected_up()
    swap(texture, 1)
    look_down(scene, 1, 1)
    scene.render.engine, scene.cycles.samples = "CYCLES", 1
    bpy.ops.render.render()
    assert reflected_up()[0] > before[0] + 0.2
    swap(texture, 2)
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "pending.blend"))
    bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "pending.blend"))
    assert not bpy.app.timers.is_registered(live_reflections._tick)
    scene = bpy.context.scene
    live_light.refresh(scene, bpy.context.evaluated_depsgraph_get())
    ticked()
    assert reflections.of(reflections.current()).key == light_state.read(scene).image_key


def test_a_picture_that_cannot_be_filtered_is_tried_once(scene, texture, window, monkeypatch):
    before, calls = reflected_up(), []

    def refuse(job, folder):
        calls.append(job)
        raise BakeError("No room")
        yield

    swap(texture, 1)
    live_reflections.stop()
    monkeypatch.setattr(engine, "run", refuse)
    live_light.refresh(scene, bpy.context.evaluated_depsgraph_get())
    assert live_reflections.finish() == "No room"
    for _ in range(3):
        live_light.refresh(scene, bpy.context.evaluated_depsgraph_get())
        live_reflections.finish()
    assert len(calls) == 1
    np.testing.assert_array_equal(reflected_up(), before)


def test_nothing_is_asked_for_where_nothing_reflects(scene):
    assert live_reflections.settings(None) == Settings()
