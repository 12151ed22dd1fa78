"""An object whose mesh is not what is shown, or is shared, reads its bake from a carrier."""

import bmesh
import bpy
import numpy as np
import pytest
import textured
from bakes import place, quad, random_bake, write
from pictures import colour, look_down, render
from prt_baker.addon import attributes, carrier, stamp, uv_maps, writeback
from prt_baker.addon.prt.layout import Layout

LAYOUT = Layout(3)


def depsgraph():
    return bpy.context.evaluated_depsgraph_get()


def needs_modifier(obj):
    return carrier.needs_modifier(obj, depsgraph())


def shown(obj):
    """The transfer that the evaluated mesh of ``obj`` has."""
    with carrier.evaluated_mesh(obj, depsgraph()) as mesh:
        stored = attributes.take(mesh)
    return np.concatenate([values for _, values in stored.values()], axis=1)


def subdivided(scene, levels=1):
    obj = quad(scene)
    modifier = obj.modifiers.new("Subdivision", "SUBSURF")
    modifier.subdivision_type, modifier.levels, modifier.render_levels = "SIMPLE", levels, levels
    return obj


def folded(scene):
    """Two squares that meet in a right angle, with two levels of subdivision."""
    mesh = bpy.data.meshes.new("Fold")
    places = [(0, 0, 0), (0, 1, 0), (1, 1, 0), (1, 0, 0), (0, 1, 1), (0, 0, 1)]
    mesh.from_pydata(places, [], [(0, 3, 2, 1), (0, 1, 4, 5)])
    obj = place(scene, mesh, 0, 0)
    obj.modifiers.new("Subdivision", "SUBSURF").subdivision_type = "SIMPLE"
    return obj


class TestNeed:
    def test_a_plain_mesh_carries_its_bake(self, scene):
        assert not needs_modifier(quad(scene))

    def test_shape_keys_armatures_and_deforming_modifiers_do_not_need_one(self, scene):
        obj = quad(scene)
        obj.shape_key_add(name="Basis")
        for kind in ("ARMATURE", "SIMPLE_DEFORM", "SMOOTH"):
            obj.modifiers.new(kind, kind)
        assert not needs_modifier(obj)

    @pytest.mark.parametrize("kind", ["SUBSURF", "MIRROR", "ARRAY", "SOLIDIFY", "NODES"])
    def test_modifiers_that_make_geometry_need_one(self, scene, kind):
        obj = quad(scene)
        obj.modifiers.new(kind, kind)
        assert needs_modifier(obj)

    def test_a_modifier_that_is_off_does_not(self, scene):
        obj = quad(scene)
        obj.modifiers.new("Array", "ARRAY").show_viewport = False
        assert not needs_modifier(obj)

    def test_a_shared_mesh_needs_one_but_a_fake_user_does_not(self, scene):
        obj = quad(scene)
        obj.data.use_fake_user = True
        assert not needs_modifier(obj)
        place(scene, obj.data, 2, 0)
        assert needs_modifier(obj)

    def test_ours_does_not_count(self, scene):
        obj = quad(scene)
        other = place(scene, obj.data, 2, 0)
        write(scene, LAYOUT, obj)
        bpy.data.objects.remove(other)
        assert not needs_modifier(obj)


@pytest.mark.parametrize("domain", ["POINT", "CORNER"])
def test_the_values_arrive_bit_for_bit(scene, domain):
    obj = subdivided(scene, 2)
    [(_, result, its_stamp)] = write(scene, LAYOUT, obj, domain=domain)
    np.testing.assert_array_equal(shown(obj)[:, :9], result.transfer[:, 0])
    np.testing.assert_array_equal(attributes.read(obj, its_stamp).transfer, result.transfer)
    assert not attributes.names(obj.data)


def test_objects_that_share_a_mesh_show_their_own(scene):
    first = quad(scene)
    second = place(scene, first.data, 2, 0)
    for obj, result, _ in write(scene, LAYOUT, first, second):
        np.testing.assert_array_equal(shown(obj)[:, :9], result.transfer[:, 0])


def test_another_count_reads_the_nearest_surface(scene):
    obj = subdivided(scene)
    _, result, its_stamp = random_bake(obj, LAYOUT)
    with carrier.evaluated_mesh(obj, depsgraph()) as mesh:
        result.transfer[:, 0, 0] = [vertex.co.x for vertex in mesh.vertices]
    writeback.write(scene, [(obj, result, its_stamp)], LAYOUT)
    obj.modifiers[0].levels = 3
    with carrier.evaluated_mesh(obj, depsgraph()) as mesh:
        places = np.array([vertex.co.x for vertex in mesh.vertices])
    np.testing.assert_allclose(shown(obj)[:, 0], places, atol=1e-6)


def test_another_count_keeps_sharp_edges_sharp(scene):
    obj = folded(scene)
    _, result, its_stamp = random_bake(obj, LAYOUT, "CORNER")
    result.transfer[:16] = 1  # four corners on each of the four faces of the floor
    result.transfer[16:] = 2
    writeback.write(scene, [(obj, result, its_stamp)], LAYOUT)
    obj.modifiers[0].levels = 2
    np.testing.assert_array_equal(shown(obj)[:, 0], np.repeat([1, 2], 64))


def test_the_modifier_is_the_last_and_not_the_active_one(scene):
    obj = subdivided(scene)
    active = obj.modifiers.active
    write(scene, LAYOUT, obj)
    late = obj.modifiers.new("Late", "SMOOTH")
    obj.modifiers.active = active
    write(scene, LAYOUT, obj)
    assert [m.name for m in obj.modifiers] == ["Subdivision", late.name, "PRT Bake"]
    assert obj.modifiers.active == active


def test_all_objects_alike_share_one_group_and_a_new_bake_replaces(scene):
    objects = [subdivided(scene), subdivided(scene)]
    for _ in range(2):
        write(scene, LAYOUT, *objects)
        assert len({obj.modifiers[-1].node_group for obj in objects}) == 1
        assert sum("prt_carrier" in obj for obj in bpy.data.objects) == 2
        assert len(bpy.data.meshes) == 4


def test_carriers_are_in_no_scene_and_hold_only_the_bake(scene):
    obj = subdivided(scene)
    obj.data.uv_layers.new()
    write(scene, LAYOUT, obj)
    holder = carrier.of(obj)
    assert not holder.users_scene
    assert not holder.data.uv_layers
    assert len(holder.data.materials) == 0


def test_a_bake_moves_between_mesh_and_carrier(scene):
    obj = quad(scene)
    write(scene, LAYOUT, obj)
    assert attributes.names(obj.data)
    obj.modifiers.new("Array", "ARRAY")
    write(scene, LAYOUT, obj)
    assert not attributes.names(obj.data)
    assert carrier.of(obj)
    obj.modifiers.remove(obj.modifiers[0])
    write(scene, LAYOUT, obj)
    assert attributes.names(obj.data)
    assert not carrier.of(obj)
    assert len(bpy.data.objects) == 1


def test_carriers_survive_save_and_load(scene, tmp_path):
    obj = subdivided(scene)
    [(_, result, _)] = write(scene, LAYOUT, obj)
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "saved.blend"))
    bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "saved.blend"))
    obj = bpy.data.objects["Quad"]
    np.testing.assert_array_equal(attributes.read(obj, stamp.read(obj)).transfer, result.transfer)
    np.testing.assert_array_equal(shown(obj)[:, :9], result.transfer[:, 0])


def test_cycles_shows_the_same_picture(scene, tmp_path):
    """Exactly, except where objects no longer share one mesh: Cycles then traces them as several,
    and rounds differently."""
    sun = bpy.data.objects.new("Sun", bpy.data.lights.new("Sun", "SUN"))
    sun.rotation_euler = 0.5, 0.5, 0
    scene.collection.objects.link(sun)
    look_down(scene, 6, 2)
    alone = subdivided(scene)
    shared = quad(scene, 2, 0)
    turned = place(scene, shared.data, 4, 0)
    turned.rotation_euler = 0.3, 0.2, 0.1
    before = colour(render(scene, tmp_path, "CYCLES"), "Combined")
    write(scene, LAYOUT, alone, shared, turned)
    after = colour(render(scene, tmp_path, "CYCLES"), "Combined")
    assert before.max() > 0.1
    np.testing.assert_array_equal(after[:, :20], before[:, :20])
    np.testing.assert_allclose(after, before, atol=1e-4)


def test_adaptive_subdivision_is_told(scene):
    obj = subdivided(scene)
    assert not writeback.notes(scene, [obj])
    if bpy.app.version >= (5, 0):
        obj.modifiers[0].use_adaptive_subdivision = True
    else:
        obj.cycles.use_adaptive_subdivision = True
    [note] = writeback.notes(scene, [obj])
    assert note == "Cycles will not subdivide 'Quad' adaptively while it is baked"


def test_uvs_of_another_count_stay_on_their_charts(scene, tmp_path):
    """A ball whose every face is a chart of its own, and one more level of subdivision: no face
    reaches over to another chart."""
    mesh = bpy.data.meshes.new("Ball")
    grown = bmesh.new()
    bmesh.ops.create_cube(grown, size=1)
    grown.to_mesh(mesh)
    grown.free()
    obj = place(scene, mesh, 0, 0)
    modifier = obj.modifiers.new("Subdivision", "SUBSURF")
    modifier.levels = modifier.render_levels = 2
    side = 10  # charts along the atlas: 96 faces
    with carrier.evaluated_mesh(obj, depsgraph()) as shown_mesh:
        faces = np.arange(len(shown_mesh.polygons))
    corner = np.array([(0.1, 0.1), (0.9, 0.1), (0.9, 0.9), (0.1, 0.9)])
    cells = np.stack([faces % side, faces // side], axis=1)[:, None]
    uvs = ((cells + corner) / side).reshape(-1, 2).astype(np.float32)
    image, _ = textured.atlas(tmp_path, LAYOUT, 8)
    writeback.write(scene, [textured.bake(obj, LAYOUT, 8, uvs)], LAYOUT, [image])
    modifier.levels = 3
    with carrier.evaluated_mesh(obj, depsgraph()) as shown_mesh:
        found = uv_maps.read(shown_mesh).reshape(-1, 4, 2) * side
    assert len(found) == 4 * len(faces)
    assert np.ptp(found, axis=1).max() < 0.55  # half a chart is 0.4, on a smoother surface
    assert np.ptp(found, axis=1).min() > 0.3
    np.testing.assert_array_equal(np.bincount(cell_of(found, side)), np.full(len(faces), 4))


def cell_of(uvs, side):
    """The chart in which the middle of each face lies."""
    middle = uvs.mean(axis=1).astype(int)
    return middle[:, 1] * side + middle[:, 0]
