"""The buttons, on a job made up for them."""

import bpy
import pytest
from prt_baker.addon import bake, cache_folder, light_state, run_state, stamp
from prt_baker.addon.atlas_files import Target
from prt_baker.addon.prt.errors import BakeError
from prt_baker.addon.prt.job import Progress, Settings
from stamped import put_bake


@pytest.fixture
def cube(scene):
    """A cube, selected, in a scene with a world."""
    scene.world = bpy.data.worlds.new("World")
    bpy.ops.mesh.primitive_cube_add()
    return bpy.context.object


@pytest.fixture
def calls(monkeypatch):
    """What the jobs were asked for."""
    asked = []

    def fake(name):
        def job(*arguments):
            yield Progress("scene", 0.0)
            asked.append((name, *arguments))
            return {}

        return job

    for name in ("bake", "verify", "update_light"):
        monkeypatch.setattr(bake, name, fake(name))
    return asked


def why_not(operator):
    """The sentence of a greyed button."""
    assert not operator.poll()
    with pytest.raises(RuntimeError) as caught:
        operator()
    return str(caught.value)


def test_bake_passes_the_settings(scene, cube, calls):
    scene.prt.order, scene.prt.rays, scene.prt.seed, scene.prt.threads = 4, 99, 7, 1
    put_bake(scene, cube)
    assert bpy.ops.prt.bake() == {"FINISHED"}
    expected = Settings(order=4, rays=99, seed=7, threads=1, cache=cache_folder.path())
    assert calls == [("bake", scene.name, ["Cube"], expected, None, Target())]


def test_invoked_in_the_background_it_runs_to_the_end(scene, cube, calls):
    assert bpy.ops.prt.bake("INVOKE_DEFAULT") == {"FINISHED"}
    assert len(calls) == 1


def test_defaults_are_the_designs(scene):
    assert (scene.prt.order, scene.prt.rays, scene.prt.seed, scene.prt.threads) == (3, 256, 0, 0)


def test_bake_without_a_world_says_what_to_do(scene, cube):
    scene.world = None
    assert "has no world: add one" in why_not(bpy.ops.prt.bake)


def test_bake_in_edit_mode_says_what_to_do(scene, cube):
    bpy.ops.object.mode_set(mode="EDIT")
    assert "Leave Edit Mode first" in why_not(bpy.ops.prt.bake)
    bpy.ops.object.mode_set(mode="OBJECT")


@pytest.mark.parametrize("name", ["update_light", "verify", "remove_bake"])
def test_without_a_bake_the_rest_is_grey(scene, cube, name):
    assert "Nothing is baked" in why_not(getattr(bpy.ops.prt, name))


def test_cancel_is_grey_when_nothing_runs(scene):
    assert "Nothing is running" in why_not(bpy.ops.prt.cancel)


def test_while_a_job_runs_only_cancel_is_there(scene, cube):
    put_bake(scene, cube)
    run = run_state.begin("Bake PRT")
    try:
        for name in ("bake", "update_light", "verify", "remove_bake"):
            assert "Bake PRT is running" in why_not(getattr(bpy.ops.prt, name))
        assert bpy.ops.prt.cancel() == {"FINISHED"}
        assert run.stop
    finally:
        run_state.end(run)


def test_a_bake_error_is_the_operators_error(scene, cube, monkeypatch):
    def refuse(*_arguments):
        raise BakeError("The light is broken")
        yield

    monkeypatch.setattr(bake, "bake", refuse)
    with pytest.raises(RuntimeError, match="The light is broken"):
        bpy.ops.prt.bake()
    assert run_state.current() is None


def test_a_bug_keeps_its_traceback(scene, cube, monkeypatch):
    def fail(*_arguments):
        yield Progress("scene", 0.0)
        raise ZeroDivisionError("a bug of ours")

    monkeypatch.setattr(bake, "bake", fail)
    with pytest.raises(RuntimeError, match=r"Traceback[\s\S]*a bug of ours"):
        bpy.ops.prt.bake()
    assert run_state.current() is None


def test_verify_and_remove_are_about_the_selected_bakes_else_all(scene, cube, calls):
    bpy.ops.mesh.primitive_cube_add()
    other = bpy.context.object
    put_bake(scene, cube, other)
    bpy.ops.prt.verify()
    other.select_set(False)
    bpy.ops.prt.verify()
    assert [sorted(call[2]) for call in calls] == [["Cube.001"], ["Cube", "Cube.001"]]
    assert all(call[3].verify_points > 0 for call in calls)


def test_remove_bake_removes(scene, cube):
    put_bake(scene, cube)
    assert bpy.ops.prt.remove_bake() == {"FINISHED"}
    assert stamp.KEY not in cube
    assert light_state.KEY not in scene


def test_update_light_asks_for_the_scene(scene, cube, calls):
    put_bake(scene, cube)
    bpy.ops.prt.update_light()
    assert calls == [("update_light", scene.name)]


def test_a_bake_is_one_undo_step(scene, cube, monkeypatch):
    def mark(scene_name, names, *_):
        yield Progress("scene", 0.0)
        put_bake(bpy.data.scenes[scene_name], *(bpy.data.objects[name] for name in names))
        return {}

    monkeypatch.setattr(bake, "bake", mark)
    bpy.ops.ed.undo_push(message="before")
    bpy.ops.prt.bake("EXEC_DEFAULT", True)
    assert stamp.KEY in bpy.data.objects["Cube"]
    bpy.ops.ed.undo()
    assert stamp.KEY not in bpy.data.objects["Cube"]
    assert light_state.KEY not in bpy.context.scene
    bpy.ops.ed.redo()
    assert stamp.KEY in bpy.data.objects["Cube"]


def test_only_settings_are_saved(scene):
    kept = {prop.identifier for prop in scene.prt.bl_rna.properties if not prop.is_readonly}
    exact = {"residual", "turns", "peaks", "final_light"}
    plain = {"name", "order", "quality", "rays", "tolerance", "seed", "threads"}
    plain |= {"gltf_short", "gltf_compress", "gltf_error", "gltf_ibl"}
    plain |= {"reflections", "visibility_order", "keep_direct"}
    texture = {"size_by", "resolution", "texel_density", "shared_atlas", "padding_mip", "half"}
    where = {"carrier", "image_folder", "pack_images", "engine_images", "bounces", "all_bounces"}
    assert kept == plain | exact | texture | where


def test_a_file_saved_during_a_bake_knows_nothing_of_it(scene, cube, monkeypatch, tmp_path):
    before, during = tmp_path / "before.blend", tmp_path / "during.blend"

    def save(*_arguments):
        yield Progress("transfer", 0.5)
        bpy.ops.wm.save_as_mainfile(filepath=str(during), copy=True, compress=False)
        return {}

    monkeypatch.setattr(bake, "bake", save)
    bpy.ops.wm.save_as_mainfile(filepath=str(before), copy=True, compress=False)
    bpy.ops.prt.bake()
    assert abs(during.stat().st_size - before.stat().st_size) < 4096
    with bpy.data.libraries.load(str(during)) as (stored, _):
        assert "PRT Shading" not in stored.node_groups
        assert stored.objects == ["Cube"]
