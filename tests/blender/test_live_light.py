"""The light follows the world by itself, costs nothing when nothing changes, and never lies."""

import bpy
import numpy as np
import pytest
from bakes import principled, quad, write
from prt_baker.addon import engine, light_state, live_light, world, writeback
from prt_baker.addon.light_state import LightState
from prt_baker.addon.prt.files import images
from prt_baker.addon.prt.layout import Layout
from prt_baker.addon.prt.light import projection
from worlds import environment, generated, loaded, new_world, picture


def world_light(scene, folder):
    """What a projection from the beginning says: the world's reading, and its image_sh."""
    got = world.read(scene, bpy.context.evaluated_depsgraph_get(), folder)
    return got, projection.project(got.source).image_sh


def truth(scene, folder):
    """The light (25, 3) of the world as it is."""
    got, image_sh = world_light(scene, folder)
    return projection.world_sh(image_sh, got.source.strength, got.source.rotation)


def bake(scene, folder, follows=True):
    """A made-up bake under the scene's world; the handlers have nothing left to do."""
    obj = quad(scene, material=principled(Base_Color=(0.8, 0.6, 0.4, 1)))
    write(scene, Layout(3), obj)
    got, image_sh = world_light(scene, folder)
    radiance = truth(scene, folder)
    state = LightState(got.image_key, image_sh, radiance, radiance, follows)
    writeback.set_light(state)
    light_state.write(scene, state)
    update()
    return obj


def update():
    bpy.context.view_layer.update()


def shown(scene):
    """The light that is kept, after a look whether it is also the one that the materials show."""
    kept = light_state.read(scene)
    assert not writeback.set_light(kept)
    return kept.radiance_sh


def counted(monkeypatch, owner, name):
    """Calls of ``owner.name``, one entry each."""
    calls, real = [], getattr(owner, name)
    monkeypatch.setattr(owner, name, lambda *a, **k: calls.append(a) or real(*a, **k))
    return calls


@pytest.fixture
def no_engine(monkeypatch):
    """Turning and tinting must need no ray and no pixel."""
    calls = counted(monkeypatch, engine, "run")
    yield
    assert not calls


@pytest.mark.parametrize("kind", ["POINT", "TEXTURE"])
def test_a_turned_world_is_what_a_new_projection_says(scene, tmp_path, no_engine, kind):
    nodes = environment(scene, generated(picture()), rotation=(0, 0, 0), kind=kind)
    bake(scene, tmp_path)
    before = shown(scene)
    nodes["mapping"].inputs["Rotation"].default_value[2] = np.pi / 2
    update()
    expected = truth(scene, tmp_path)
    root_mean_square = np.sqrt(np.square(expected).mean())
    assert np.abs(shown(scene) - expected).max() < 1e-4 * root_mean_square
    assert np.abs(shown(scene) - before).max() > 0.1 * root_mean_square


def test_strength_is_followed(scene, tmp_path, no_engine):
    nodes = environment(scene, generated(picture()))
    bake(scene, tmp_path)
    before = shown(scene)
    nodes["background"].inputs["Strength"].default_value *= 3
    update()
    np.testing.assert_allclose(shown(scene), 3 * before, rtol=1e-6)


def test_the_colour_of_a_plain_world_is_followed(scene, tmp_path, no_engine):
    tree = new_world(scene)
    bake(scene, tmp_path)
    tree.nodes["Background"].inputs["Color"].default_value = (1, 0.5, 0, 1)
    update()
    np.testing.assert_allclose(shown(scene), truth(scene, tmp_path), atol=1e-9)
    assert shown(scene)[0, 0] > 0


def test_the_light_at_the_bake_is_kept(scene, tmp_path):
    nodes = environment(scene, generated(picture()))
    bake(scene, tmp_path)
    before = shown(scene)
    nodes["mapping"].inputs["Rotation"].default_value[2] += 1
    update()
    np.testing.assert_array_equal(light_state.read(scene).baked_radiance_sh, before)


@pytest.mark.parametrize("how", ["image", "world", "to a colour", "from a colour"])
def test_another_image_is_projected_once(scene, tmp_path, monkeypatch, how):
    if how == "from a colour":
        new_world(scene)
    else:
        nodes = environment(scene, loaded(picture(), tmp_path / "one.exr"))
    bake(scene, tmp_path)
    runs = counted(monkeypatch, engine, "run")
    if how == "to a colour":
        new_world(scene)
    elif how == "image":
        nodes["texture"].image = loaded(picture(seed=1), tmp_path / "two.exr")
    else:
        image = loaded(picture(seed=1), tmp_path / "two.exr")
        image.pack()
        environment(scene, image, rotation=(0, 0, 1))
    update()
    update()
    assert len(runs) == 1
    np.testing.assert_allclose(shown(scene), truth(scene, tmp_path), atol=1e-6)


def test_nothing_is_done_when_nothing_changed(scene, tmp_path, monkeypatch):
    """A drag at a material's slider updates a node tree too, at every step."""
    nodes = environment(scene, generated(picture()))
    obj = bake(scene, tmp_path)
    nodes["mapping"].inputs["Rotation"].default_value[2] += 1
    update()
    read = counted(monkeypatch, light_state, "read")
    written = counted(monkeypatch, writeback, "set_light")
    looks = counted(monkeypatch, world, "read_nodes")
    tree = obj.data.materials[0].node_tree
    for node in tree.nodes:
        node.location.x += 10
    tree.update_tag()
    update()
    nodes["background"].inputs["Strength"].default_value += 0
    update()
    assert looks
    assert not read
    assert not written


def test_one_change_is_written_once(scene, tmp_path, monkeypatch):
    nodes = environment(scene, generated(picture()))
    bake(scene, tmp_path)
    written = counted(monkeypatch, writeback, "set_light")
    nodes["mapping"].inputs["Rotation"].default_value[2] += 1
    for _ in range(3):
        update()
    assert len(written) == 1


def test_a_scene_without_a_bake_is_left_alone(scene, monkeypatch):
    nodes = environment(scene, generated(picture()))
    looks = counted(monkeypatch, world, "read_nodes")
    nodes["mapping"].inputs["Rotation"].default_value[2] += 1
    update()
    scene.frame_set(5)
    assert not looks
    assert light_state.KEY not in scene


def animate(scene, nodes, angle=3.0):
    turn = nodes["mapping"].inputs["Rotation"]
    turn.keyframe_insert("default_value", frame=1)
    turn.default_value[2] += angle
    turn.keyframe_insert("default_value", frame=3)
    scene.frame_set(1)


def test_an_animated_world_is_followed_in_the_same_frame(scene, tmp_path, no_engine):
    nodes = environment(scene, generated(picture()))
    animate(scene, nodes)
    bake(scene, tmp_path)
    lights = []
    for frame in (2, 3):
        scene.frame_set(frame)
        lights.append(shown(scene))
        np.testing.assert_allclose(lights[-1], truth(scene, tmp_path), atol=1e-6)
    assert np.abs(lights[0] - lights[1]).max() > 0.1


@pytest.mark.parametrize("fault", ["damaged", "missing", "none", "no world"])
def test_a_world_that_cannot_be_read_leaves_the_light(scene, tmp_path, fault):
    nodes = environment(scene, loaded(picture(), tmp_path / "one.exr"))
    bake(scene, tmp_path)
    before, world_before = shown(scene), scene.world
    break_world(scene, nodes, tmp_path, fault)
    update()
    np.testing.assert_array_equal(shown(scene), before)
    if fault == "no world":  # of that Blender tells nobody
        live_light.refresh(scene, bpy.context.evaluated_depsgraph_get())
    assert live_light.problem
    assert "\n" not in live_light.problem
    scene.world = world_before
    nodes["texture"].image = bpy.data.images["one.exr"]
    update()
    assert not live_light.problem
    np.testing.assert_array_equal(shown(scene), before)


def break_world(scene, nodes, folder, fault):
    if fault == "no world":
        scene.world = None
        return
    image = loaded(picture(seed=1), folder / "two.exr") if fault != "none" else None
    if fault == "damaged":
        (folder / "two.exr").write_bytes((folder / "two.exr").read_bytes()[:700])
    elif fault == "missing":
        (folder / "two.exr").unlink()
    nodes["texture"].image = image


def test_a_damaged_image_is_tried_once(scene, tmp_path, monkeypatch):
    nodes = environment(scene, generated(picture()))
    bake(scene, tmp_path)
    runs = counted(monkeypatch, engine, "run")
    break_world(scene, nodes, tmp_path, "damaged")
    update()
    nodes["mapping"].inputs["Rotation"].default_value[2] += 0
    update()
    assert len(runs) == 1
    images.write_exr(str(tmp_path / "two.exr"), picture(seed=1))
    nodes["mapping"].inputs["Rotation"].default_value[2] += 0
    update()
    assert not live_light.problem
    np.testing.assert_allclose(shown(scene), truth(scene, tmp_path), atol=1e-6)


def test_a_tree_that_must_be_rendered_asks_for_update_light(scene, tmp_path, no_engine):
    nodes = environment(scene, generated(picture()))
    bake(scene, tmp_path)
    before = shown(scene)
    nodes["mapping"].inputs["Scale"].default_value[0] = 2
    update()
    assert "Update Light" in live_light.problem
    np.testing.assert_array_equal(shown(scene), before)


def test_a_rendered_light_follows_nothing(scene, tmp_path, no_engine):
    nodes = environment(scene, generated(picture()))
    bake(scene, tmp_path, follows=False)
    before = shown(scene)
    nodes["background"].inputs["Strength"].default_value *= 3
    update()
    np.testing.assert_array_equal(shown(scene), before)


def test_a_fault_of_ours_is_not_swallowed(scene, tmp_path, monkeypatch):
    nodes = environment(scene, generated(picture()))
    bake(scene, tmp_path)
    monkeypatch.setattr(writeback, "set_light", lambda light: 1 / 0)
    nodes["background"].inputs["Strength"].default_value *= 3
    with pytest.raises(ZeroDivisionError):
        live_light.refresh(scene, bpy.context.evaluated_depsgraph_get())


def test_a_light_written_meanwhile_is_brought_up_to_date(scene, tmp_path):
    """A bake that ran while the world was turned ends with the old light."""
    nodes = environment(scene, generated(picture()))
    bake(scene, tmp_path)
    old = scene[light_state.KEY]
    nodes["background"].inputs["Strength"].default_value *= 2
    update()
    expected = shown(scene)
    scene[light_state.KEY] = old
    assert live_light.refresh(scene, bpy.context.evaluated_depsgraph_get())
    np.testing.assert_array_equal(shown(scene), expected)
