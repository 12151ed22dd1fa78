"""A real bake under a world that is turned, swapped and animated: EEVEE shows the new light, and no
ray is traced for it."""

import bpy
import numpy as np
import pytest
from bakes import principled
from meshes import ball, place
from pictures import colour, look_down, render, render_frames
from prt_baker.addon import attributes, bake, engine, light_state, stamp, world, writeback
from prt_baker.addon.prt.job import Settings
from prt_baker.addon.prt.light import lat_long, projection
from worlds import environment, loaded, picture

ALBEDO = np.array([0.8, 0.6, 0.4])
PLAIN = Settings(rays=256, residual=False)
VIEW = 3.2  # metres, at ten pixels a metre


def stage(scene, folder):
    """A triangle that fills the view, half in the shadow of a ball beside it; the world's nodes."""
    nodes = environment(scene, loaded(picture(), folder / "sky.exr"), 0.3, rotation=(0, 0, 0))
    mesh = bpy.data.meshes.new("Floor")
    mesh.from_pydata([(-1, -1, 0), (9, -1, 0), (-1, 9, 0)], [], [(0, 1, 2)])
    mesh.materials.append(principled("Floor", Base_Color=(*ALBEDO, 1)))
    mesh.shade_smooth()
    place(mesh, "Floor")
    place(ball(), "Beside").location = -2, -2, 1
    look_down(scene, VIEW, VIEW)
    bpy.context.view_layer.update()
    return nodes


def run(steps):
    for _ in steps:
        pass


@pytest.fixture
def baked(scene, tmp_path, monkeypatch):
    """The nodes of a world under which the floor is baked; from now on no engine may start."""
    nodes = stage(scene, tmp_path)
    run(bake.bake(scene.name, ["Floor"], PLAIN))
    monkeypatch.setattr(engine, "run", lambda *_: pytest.fail("the engine was started"))
    return nodes


def projected(pixels, nodes):
    """The light (25, 3) of a world that shows ``pixels``, projected after it was turned: each
    direction looks its radiance up, so that no coefficient is rotated."""
    turn = np.array(nodes["mapping"].inputs["Rotation"].default_value)[2]
    columns = turn / (2 * np.pi) * pixels.shape[1]
    assert columns == pytest.approx(round(columns), abs=1e-4), "whole columns"
    turned = np.roll(pixels, round(columns), axis=1)
    strength = nodes["background"].inputs["Strength"].default_value
    return lat_long.project(turned, 5) * strength


def expected_picture(scene, radiance_sh):
    """Exit radiance (H, W, 3) at every pixel, by numpy: interpolated transfer times the light."""
    floor = bpy.data.objects["Floor"]
    transfer = attributes.read(floor, stamp.read(floor)).transfer[:, 0].astype(np.float64)
    pixels = scene.render.resolution_x
    centres = (np.arange(pixels) + 0.5) / 10
    x, y = np.meshgrid(centres, centres[::-1])
    u, v = (x + 1) / 10, (y + 1) / 10
    weights = np.stack([1 - u - v, u, v], axis=-1)
    return np.maximum(0, weights @ transfer @ radiance_sh[: transfer.shape[1]]) * ALBEDO


def shown(scene):
    """The light that is kept, after a look whether it is also the one that the materials show."""
    kept = light_state.read(scene)
    assert not writeback.set_light(kept)
    return kept.radiance_sh


def test_a_quarter_turn_is_a_new_projection_without_a_ray(scene, tmp_path, baked, monkeypatch):
    before = shown(scene)
    baked["mapping"].inputs["Rotation"].default_value[2] = np.pi / 2
    bpy.context.view_layer.update()
    expected = projected(picture(), baked)
    size = np.sqrt(np.square(expected).mean())
    assert np.abs(shown(scene) - expected).max() < 1e-4 * size
    assert np.abs(shown(scene) - before).max() > 0.1 * size
    turned = colour(render(scene, tmp_path), "Combined")
    monkeypatch.undo()
    run(bake.bake(scene.name, ["Floor"], PLAIN))
    fresh = colour(render(scene, tmp_path), "Combined")
    np.testing.assert_allclose(turned, fresh, atol=1e-3 * fresh.mean())
    np.testing.assert_allclose(turned, expected_picture(scene, expected), rtol=2e-3)


def test_a_rendered_animation_turns_the_light_frame_by_frame(scene, tmp_path, baked):
    turn = baked["mapping"].inputs["Rotation"]
    for frame in (1, 2, 3):
        turn.default_value[2] = (frame - 1) * np.pi / 2
        turn.keyframe_insert("default_value", frame=frame)
    frames = render_frames(scene, tmp_path, 1, 3)
    for frame, seen in enumerate(frames, 1):
        turn.default_value[2] = (frame - 1) * np.pi / 2
        expected = expected_picture(scene, projected(picture(), baked))
        np.testing.assert_allclose(seen, expected, rtol=2e-3, err_msg=f"frame {frame}")
    assert np.ptp(frames.mean(axis=(1, 2)), axis=0).min() > 0.02 * frames.mean()


def test_strength_down_to_nothing_and_back(scene, baked, monkeypatch):
    before, written = shown(scene), []
    real = writeback.set_light
    monkeypatch.setattr(writeback, "set_light", lambda now: written.append(now) or real(now))
    strength = baked["background"].inputs["Strength"]
    value = strength.default_value
    for step in (0, 0, value, value):
        strength.default_value = step
        bpy.context.view_layer.update()
    assert [bool(now.radiance_sh.any()) for now in written] == [False, True]
    np.testing.assert_array_equal(light_state.read(scene).radiance_sh, before)
    np.testing.assert_array_equal(light_state.read(scene).baked_radiance_sh, before)


def test_nothing_is_written_for_what_is_no_light(scene, baked, monkeypatch):
    """Objects move, frames change, materials are edited."""
    written, kept = [], scene[light_state.KEY]
    monkeypatch.setattr(writeback, "set_light", written.append)
    bpy.data.objects["Beside"].location.x -= 1
    bpy.data.materials["Floor"].node_tree.nodes["Principled BSDF"].inputs[2].default_value = 0.4
    bpy.context.view_layer.update()
    scene.frame_set(7)
    assert not written
    assert scene[light_state.KEY] == kept


def test_a_swapped_image_starts_the_engine_for_its_light_alone(scene, tmp_path, baked, monkeypatch):
    monkeypatch.undo()
    jobs, real = [], engine.run
    monkeypatch.setattr(engine, "run", lambda job, at: jobs.append(job) or real(job, at))
    baked["texture"].image = loaded(picture(seed=1), tmp_path / "other.exr")
    for _ in range(2):
        bpy.context.view_layer.update()
    assert [job.kind for job in jobs] == ["light"]
    got = world.read(scene, bpy.context.evaluated_depsgraph_get(), tmp_path)
    expected = projection.world_sh(
        projection.project(got.source).image_sh, got.source.strength, got.source.rotation
    )
    np.testing.assert_allclose(shown(scene), expected, atol=1e-6)
