"""The whole way with the real engine: what it computes is what the scene holds, or nothing is."""

from contextlib import suppress

import bmesh
import bpy
import numpy as np
import pytest
import snapshot
from bakes import principled
from meshes import ball, mesh_of, place
from pictures import colour, look_down, render
from prt_baker.addon import (
    attributes,
    bake,
    engine,
    light_state,
    materials,
    remove,
    stamp,
    world,
    writeback,
)
from prt_baker.addon import scene as scene_arrays
from prt_baker.addon.prt import job as jobs
from prt_baker.addon.prt import run
from prt_baker.addon.prt.job import Settings
from prt_baker.addon.prt.light import projection
from prt_baker.addon.prt.steps import value_of
from worlds import environment, generated, loaded, picture

FEW = Settings(rays=32, seed=5, threads=1)
LONG = Settings(rays=65536, threads=1)


pytestmark = pytest.mark.usefixtures("temporary")


def grid(count=4):
    return mesh_of(bmesh.ops.create_grid, "Grid", x_segments=count, y_segments=count, size=1)


def stage(scene):
    """A floor below a ball, under a sky."""
    environment(scene, generated(picture()))
    floor, above = place(grid(), "Floor"), place(ball(), "Above")
    above.location.z = 1.5
    for obj in (floor, above):
        obj.data.materials.append(principled(obj.name, Base_Color=(0.8, 0.6, 0.4, 1)))
    bpy.context.view_layer.update()
    return [floor, above]


def baked(scene, objects, settings=FEW, hdri=None):
    return value_of(bake.bake(scene.name, [obj.name for obj in objects], settings, hdri))


def held(obj):
    """The transfer that ``obj`` shows."""
    return attributes.read(obj, stamp.read(obj)).transfer


def computed(objects, settings, folder):
    """What the engine says of ``objects``, in this process."""
    depsgraph = bpy.context.evaluated_depsgraph_get()
    vertices, triangles, _ = scene_arrays.read_occluders(depsgraph)
    receivers = scene_arrays.read_receivers(depsgraph, objects)
    job = jobs.Job("bake", settings, None, receivers, vertices, triangles)
    folder.mkdir()
    jobs.write(job, folder)
    steps = run.run(jobs.read(folder))
    return [result.at_elements(result.transfer) for result in value_of(steps).receivers]


def kinds(scene):
    """One object of each kind that is written in its own way."""
    floor, above = stage(scene)
    smooth = place(ball(), "Subdivided")
    smooth.modifiers.new("Subdivision", "SUBSURF").levels = 1
    twins = [place(grid(2), "Twin")]
    twins.append(place(twins[0].data, "Other Twin"))
    bare = place(ball(smooth=False), "Without Material")
    for i, obj in enumerate((smooth, *twins, bare)):
        obj.location = 3 * (i + 1), 0, 0.5 * i
    bpy.context.view_layer.update()
    return [floor, above, smooth, *twins, bare]


def test_the_scene_holds_what_the_engine_computes(scene, tmp_path):
    objects = kinds(scene)
    report = baked(scene, objects)
    for obj, values in zip(objects, computed(objects, FEW, tmp_path / "job"), strict=True):
        np.testing.assert_array_equal(held(obj), values, err_msg=obj.name)
        assert obj[stamp.SWITCH] == 1
    assert [entry["name"] for entry in report["objects"]] == [obj.name for obj in objects]
    assert [stamp.read(obj).by_modifier for obj in objects] == [False] * 2 + [True] * 3 + [False]
    assert stamp.read(objects[-1]).domain == "CORNER"


def test_the_light_is_that_of_the_world(scene, tmp_path):
    baked(scene, stage(scene))
    got = world.read(scene, bpy.context.evaluated_depsgraph_get(), tmp_path)
    image_sh = projection.project(got.source).image_sh
    expected = projection.world_sh(image_sh, got.source.strength, got.source.rotation)
    state = light_state.read(scene)
    np.testing.assert_allclose(state.radiance_sh, expected, atol=1e-6)
    np.testing.assert_array_equal(state.baked_radiance_sh, state.radiance_sh)
    assert not writeback.set_light(state), "the materials show it already"


def test_the_same_seed_is_the_same_result_whatever_the_threads(scene):
    objects = stage(scene)
    first = baked(scene, objects)
    values = [held(obj) for obj in objects]
    second = baked(scene, objects, Settings(rays=32, seed=5, threads=3))
    assert first["job_hash"] == second["job_hash"]
    for obj, before in zip(objects, values, strict=True):
        np.testing.assert_array_equal(held(obj), before)


@pytest.mark.parametrize("reached", [1, 2, 3, "transfer"])
@pytest.mark.parametrize("again", [False, True])
def test_a_bake_that_is_cancelled_changes_nothing(scene, temporary, tmp_path, reached, again):
    objects = stage(scene)
    if again:
        baked(scene, objects)
    loaded(picture(1), tmp_path / "other.exr").use_fake_user = True
    before = snapshot.of(scene), scene.world, set(bpy.data.images)
    names = [obj.name for obj in objects]
    steps = bake.bake(scene.name, names, LONG, str(tmp_path / "other.exr"))
    for taken, progress in enumerate(steps, 1):
        if reached in (taken, progress.phase):
            break
    assert len(list(temporary.iterdir())) == 1
    steps.close()
    assert list(temporary.iterdir()) == []
    assert (snapshot.of(scene), scene.world, set(bpy.data.images)) == before


@pytest.mark.parametrize("again", [False, True])
@pytest.mark.parametrize("hdri", [False, True])
def test_a_bake_that_cannot_be_written_changes_nothing(scene, tmp_path, monkeypatch, again, hdri):
    objects = kinds(scene)
    if again:
        baked(scene, objects)
    loaded(picture(1), tmp_path / "other.exr")
    bpy.data.images.remove(bpy.data.images["other.exr"])
    before = snapshot.of(scene), scene.world, set(bpy.data.images), set(bpy.data.worlds)
    attach, calls = materials.attach, []

    def fail(material, *look):
        calls.append(material)
        if len(calls) == 2:
            raise RuntimeError("the second material")
        attach(material, *look)

    monkeypatch.setattr(materials, "attach", fail)
    with pytest.raises(RuntimeError, match="the second material"):
        baked(scene, objects, Settings(order=4), str(tmp_path / "other.exr") if hdri else None)
    after = snapshot.of(scene), scene.world, set(bpy.data.images), set(bpy.data.worlds)
    assert after == before


def test_another_order_takes_the_place_of_the_first(scene, tmp_path):
    objects = kinds(scene)
    for order in (4, 2, 5):
        settings = Settings(order=order, rays=16)
        baked(scene, objects, settings)
        expected = computed(objects, settings, tmp_path / str(order))
        for obj, values in zip(objects, expected, strict=True):
            np.testing.assert_array_equal(held(obj), values)
    assert len(attributes.names(objects[0].data)) == 7
    assert len([tree for tree in bpy.data.node_groups if "PRT Shading" in tree.name]) == 1
    remove.remove(scene, objects)
    assert not [a for a in objects[0].data.attributes if a.name.startswith("_PRT")]


def test_what_was_edited_while_it_baked_is_not_shown(scene):
    floor, above = stage(scene)
    steps = bake.bake(scene.name, ["Floor", "Above"], FEW)
    next(steps)
    while next(steps).phase == "scene":
        pass
    above.location.x += 1
    floor.data.vertices[3].co.z += 0.1
    floor.data.update()
    bpy.context.view_layer.update()
    value_of(steps)
    bpy.context.view_layer.update()
    assert (floor[stamp.SWITCH], above[stamp.SWITCH]) == (0, 0)


def test_what_was_deleted_while_it_baked_is_said(scene):
    objects = stage(scene)
    steps = bake.bake(scene.name, [obj.name for obj in objects], FEW)
    while next(steps).phase == "scene":
        pass
    bpy.data.objects.remove(objects[1])
    before = snapshot.of(scene)
    with pytest.raises(bake.BakeError, match="no object 'Above' any more"):
        value_of(steps)
    assert snapshot.of(scene) == before


def test_update_light_sees_painted_pixels(scene):
    objects = stage(scene)
    baked(scene, objects)
    before = light_state.read(scene)
    values = held(objects[0])
    bpy.data.images["Picture"].pixels.foreach_set(np.full(32 * 64 * 4, 0.25, np.float32))
    value_of(bake.update_light(scene.name))
    after = light_state.read(scene)
    np.testing.assert_allclose(after.radiance_sh[0], 1.5 * 0.25 * np.sqrt(4 * np.pi), rtol=1e-5)
    np.testing.assert_array_equal(after.baked_radiance_sh, before.baked_radiance_sh)
    np.testing.assert_array_equal(held(objects[0]), values)
    assert not writeback.set_light(after)


def test_verify_stamps_the_error_that_is_there(scene):
    """Nothing shadows a floor alone, so its bake is exact until it is brightened by a quarter."""
    environment(scene, generated(picture()))
    floor = place(grid(), "Floor")
    floor.data.shade_smooth()
    baked(scene, [floor])
    settings = Settings(verify_points=64, verify_rays=4096)
    value_of(bake.verify(scene.name, ["Floor"], settings))
    assert stamp.read(floor).measured_error < 2e-3
    for name in attributes.names(floor.data):
        stored = floor.data.attributes[name].data
        values = np.empty(4 * len(stored), np.float32)
        stored.foreach_get("color", values)
        stored.foreach_set("color", 1.25 * values)
    value_of(bake.verify(scene.name, ["Floor"], settings))
    assert stamp.read(floor).measured_error == pytest.approx(0.25, abs=2e-3)


def test_the_noise_of_few_rays_is_estimated_and_measured(scene):
    """Vertices so dense that the noise is all of the error."""
    above = stage(scene)[1]
    settings = Settings(rays=32, verify_points=256, verify_rays=8192)
    entry = baked(scene, [above], settings)["objects"][0]
    assert stamp.read(above).measured_error == entry["measured_error"]["on_surface"]
    assert stamp.read(above).estimated_error == entry["estimated_error"]
    assert entry["estimated_error"] == pytest.approx(entry["measured_error"]["at_points"], rel=0.5)


def test_a_fit_says_what_noise_it_shows(scene):
    """Not what its rays had, which it smooths."""
    environment(scene, generated(picture()))
    bpy.ops.mesh.primitive_torus_add(major_segments=96, minor_segments=48)
    torus = bpy.context.object
    torus.data.shade_smooth()
    settings = Settings(rays=128, verify_points=256, verify_rays=8192)
    [entry] = baked(scene, [torus], settings)["objects"]
    assert entry["values"]["fitted"] == 1
    mark = stamp.read(torus)
    assert mark.estimated_error < 0.7 * entry["estimated_error"]
    assert mark.measured_at_points is None
    both = np.hypot(mark.estimated_error, mark.interpolation_error)
    assert both == pytest.approx(mark.measured_error, rel=0.5)


def test_a_bake_is_one_step_of_undo(scene):
    stage(scene)
    scene.prt.rays = 16
    bpy.ops.ed.undo_push(message="before")
    before = str(snapshot.of(scene))  # as text: an undo exchanges the pointers
    bpy.ops.prt.bake("EXEC_DEFAULT", True)
    after = str(snapshot.of(bpy.context.scene))
    assert after != before
    bpy.ops.ed.undo()
    assert str(snapshot.of(bpy.context.scene)) == before
    bpy.ops.ed.redo()
    assert str(snapshot.of(bpy.context.scene)) == after


def test_a_saved_bake_looks_the_same_after_loading(scene, tmp_path):
    objects = kinds(scene)
    environment(scene, loaded(picture(), tmp_path / "sky.exr"))
    scene.world.probe_resolution = "128"
    baked(scene, objects, Settings(rays=16))
    look_down(scene, 2, 2)
    shown = colour(render(scene, tmp_path), "Combined")
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "baked.blend"))
    bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "baked.blend"))
    again = colour(render(bpy.context.scene, tmp_path), "Combined")
    np.testing.assert_array_equal(again, shown)
    bpy.context.scene.world.node_tree.nodes["Background"].inputs["Strength"].default_value *= 2
    bpy.context.view_layer.update()
    twice = colour(render(bpy.context.scene, tmp_path), "Combined")
    floor = shown > 0.05
    np.testing.assert_allclose(twice[floor], 2 * shown[floor], rtol=1e-3)


def test_what_the_artist_should_know_is_in_the_report(scene, capfd):
    floor, _ = stage(scene)
    tree = floor.data.materials[0].node_tree
    tree.nodes.remove(next(n for n in tree.nodes if n.type == "BSDF_PRINCIPLED"))
    [note] = baked(scene, [floor])["notes"]
    assert "'Floor' keeps its own look" in note
    with suppress(RuntimeError):
        bpy.ops.prt.bake()
    assert note in capfd.readouterr().out


def test_no_engine_is_left_running(scene):
    started = []
    real = engine._start
    objects = stage(scene)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(engine, "_start", lambda f: started.append(real(f)) or started[-1])
        steps = bake.bake(scene.name, [obj.name for obj in objects], LONG)
        while next(steps).phase != "transfer":
            pass
        steps.close()
    assert [process.poll() is not None for process in started] == [True]
