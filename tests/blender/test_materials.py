"""The baked version stands beside the artist's shader and changes nothing of it."""

import bpy
import numpy as np
import pytest
import snapshot
from bakes import add, constant_bake, full, link, output_of, principled, quad, shader, write
from pictures import colour, look_down, render
from prt_baker.addon import (
    material_plan,
    materials,
    remove,
    writeback,
)
from prt_baker.addon.light_state import LightState
from prt_baker.addon.prt.errors import BakeError
from prt_baker.addon.prt.layout import Layout

LAYOUT = Layout(3)
EXIT = 0.6  # exit radiance of a white surface in the rendered test
WORLD = np.array([0.3, 0.3, 0.3])


def ours(material, kind=None):
    nodes = [n for n in material.node_tree.nodes if n.get("prt")]
    return [n for n in nodes if kind is None or n.type == kind]


def mixed():
    """A mix of diffuse and glossy, behind a reroute."""
    material = principled("Mixed")
    diffuse = add(material, "BsdfDiffuse", Color=(0.1, 0.8, 0.3, 1))
    glossy, mix = add(material, "BsdfGlossy", Roughness=0.4), add(material, "MixShader", Fac=0.25)
    reroute = material.node_tree.nodes.new("NodeReroute")
    link(material, diffuse.outputs[0], reroute.inputs[0])
    link(material, reroute.outputs[0], mix.inputs[1])
    link(material, glossy.outputs[0], mix.inputs[2])
    link(material, mix.outputs[0], output_of(material).inputs["Surface"])
    return material


def own_output():
    """An artist's own output for EEVEE, beside the active one."""
    material = principled("Own Output", Base_Color=(0.8, 0.1, 0.1, 1))
    output = material.node_tree.nodes.new("ShaderNodeOutputMaterial")
    output.target = "EEVEE"
    diffuse = add(material, "BsdfDiffuse", Color=(0.1, 0.1, 0.8, 1))
    link(material, diffuse.outputs[0], output.inputs["Surface"])
    return material


def glowing():
    material = principled(
        "Glowing", Base_Color=(0.5, 0.5, 0.5, 1), Emission_Color=(1, 0, 0, 1), Alpha=0.5
    )
    shader(material).inputs["Emission Strength"].default_value = 0.5
    material.surface_render_method = "BLENDED"
    return material


def without_nodes():
    material = bpy.data.materials.new("Without Nodes")
    if bpy.app.version < (5, 0):
        material.use_nodes = False
    material.diffuse_color = 0.2, 0.6, 0.4, 1
    return material


def world(scene):
    scene.world = bpy.data.worlds.new("World")
    if bpy.app.version < (5, 0):
        scene.world.use_nodes = True
    scene.world.node_tree.nodes["Background"].inputs[0].default_value = (*WORLD, 1)


def gallery(scene):
    """Squares in a row, one for each kind of material; the second is not to be baked."""
    plain = principled("Plain", Base_Color=(0.8, 0.4, 0.2, 1))
    metal = principled("Metal", Base_Color=(0.2, 0.4, 0.8, 1), Metallic=0.5)
    kinds = [plain, plain, metal, glowing(), mixed(), own_output(), full(11), None, without_nodes()]
    return [quad(scene, x, 0, material) for x, material in enumerate(kinds)]


def middle(picture, x):
    return colour(picture, "Combined")[5, 10 * x + 5]


def square(picture, x):
    return colour(picture, "Combined")[:, 10 * x : 10 * x + 10]


def test_eevee_shows_bakes_and_cycles_and_unbaked_objects_stay_as_they_were(scene, tmp_path):
    world(scene)
    objects = gallery(scene)
    look_down(scene, len(objects), 1)
    before, cycles = render(scene, tmp_path), render(scene, tmp_path, "CYCLES")
    state = snapshot.of(scene)
    baked = [obj for obj in objects if obj != objects[1]]
    writeback.write(scene, [constant_bake(obj, LAYOUT) for obj in baked], LAYOUT)
    light = np.zeros((25, 3))
    light[0] = EXIT
    writeback.set_light(LightState("", light, light, light))
    after = render(scene, tmp_path)

    np.testing.assert_array_equal(square(after, 1), square(before, 1))
    expected = {
        0: EXIT * np.array([0.8, 0.4, 0.2]),
        2: 0.5 * EXIT * np.array([0.2, 0.4, 0.8]) + 0.5 * middle(before, 2),
        3: 0.5 * (EXIT * 0.5 + np.array([0.5, 0, 0])) + 0.5 * WORLD,
        5: EXIT * np.array([0.1, 0.1, 0.8]),
        6: EXIT * np.full(3, 0.5),
        7: EXIT * np.full(3, 0.8),
        8: EXIT * (np.full(3, 0.8) if bpy.app.version >= (5, 0) else np.array([0.2, 0.6, 0.4])),
    }
    for x, radiance in expected.items():
        np.testing.assert_allclose(middle(after, x), radiance, atol=3e-3, err_msg=objects[x].name)
    glossy = (middle(after, 4) - 0.75 * EXIT * np.array([0.1, 0.8, 0.3])) / 0.25
    np.testing.assert_allclose(glossy, glossy[0], atol=1e-2)

    with_bake = render(scene, tmp_path, "CYCLES")
    assert remove.remove(scene, objects) == len(baked)
    without_bake = render(scene, tmp_path, "CYCLES")
    for name, channel in cycles.items():
        np.testing.assert_array_equal(with_bake[name], channel)
        np.testing.assert_array_equal(without_bake[name], channel)
    again = render(scene, tmp_path)
    for name, channel in before.items():
        np.testing.assert_array_equal(again[name], channel)
    assert snapshot.of(scene) == state


def test_the_artists_output_stays_active(scene):
    obj = quad(scene, material=principled())
    write(scene, LAYOUT, obj)
    tree = obj.active_material.node_tree
    assert output_of(obj.active_material).is_active_output
    assert tree.get_output_node("CYCLES") == output_of(obj.active_material)
    assert tree.get_output_node("EEVEE").get("prt")


def test_beside_an_eevee_output_of_the_artists_ours_is_active_until_removed(scene):
    material = own_output()
    obj = quad(scene, material=material)
    theirs = material.node_tree.get_output_node("EEVEE")
    write(scene, LAYOUT, obj)
    assert material.node_tree.get_output_node("EEVEE").get("prt")
    remove.remove(scene, [obj])
    assert material.node_tree.get_output_node("EEVEE") == theirs
    assert output_of(material).is_active_output


def test_our_nodes_lie_in_one_frame_below_the_artists(scene):
    material = mixed()
    lowest = min(node.location.y for node in material.node_tree.nodes)
    write(scene, LAYOUT, quad(scene, material=material))
    frames = ours(material, "FRAME")
    assert [frame.label for frame in frames] == ["PRT Bake"]
    assert frames[0].location.y < lowest
    assert all(n.parent == frames[0] and not n.select for n in ours(material) if n not in frames)


def test_displacement_reaches_our_output(scene):
    material = principled()
    displacement = add(material, "Displacement")
    link(material, displacement.outputs[0], output_of(material).inputs["Displacement"])
    write(scene, LAYOUT, quad(scene, material=material))
    assert ours(material, "OUTPUT_MATERIAL")[0].inputs["Displacement"].links[0].from_node == (
        displacement
    )


def test_a_muted_shader_is_passed_through(scene):
    material = mixed()
    next(n for n in material.node_tree.nodes if n.type == "MIX_SHADER").mute = True
    plan = material_plan.read(material.node_tree)
    assert plan.surface.kind == "prt"


@pytest.mark.parametrize("unlink", [True, False])
def test_a_material_that_shows_nothing_can_be_baked(scene, unlink):
    material = principled()
    tree = material.node_tree
    tree.links.clear() if unlink else tree.nodes.clear()
    obj = quad(scene, material=material)
    state = snapshot.of(scene)
    write(scene, LAYOUT, obj)
    assert materials.without_bake([material]) == [material.name]
    remove.remove(scene, [obj])
    assert snapshot.of(scene) == state


def test_shaders_inside_of_a_group_stay_the_artists(scene):
    material = principled()
    group = bpy.data.node_groups.new("Group", "ShaderNodeTree")
    group.interface.new_socket("Shader", in_out="OUTPUT", socket_type="NodeSocketShader")
    node = add(material, "Group")
    node.node_tree = group
    link(material, node.outputs[0], output_of(material).inputs["Surface"])
    write(scene, LAYOUT, quad(scene, material=material))
    assert not ours(material, "GROUP")
    assert materials.without_bake([material, principled("Other")]) == [material.name]
    [note] = writeback.notes(scene, list(scene.objects))
    assert note.startswith("Material 'Material' keeps its own look")


class TestEdits:
    """What the artist edits after the bake shows in the baked version."""

    @pytest.fixture
    def material(self, scene):
        material = principled(Base_Color=(0.5, 0.5, 0.5, 1))
        write(scene, LAYOUT, quad(scene, material=material))
        return material

    def test_a_value_is_copied_into_the_same_nodes(self, material):
        nodes = set(ours(material))
        shader(material).inputs["Base Color"].default_value = (0.25, 0.5, 0.75, 1)
        bpy.context.view_layer.update()
        assert tuple(ours(material, "GROUP")[0].inputs[0].default_value) == (0.25, 0.5, 0.75, 1)
        assert set(ours(material)) == nodes

    def test_what_was_not_edited_is_left_alone(self, material):
        assert not materials.sync_all(bpy.context.evaluated_depsgraph_get())

    def test_a_metallic_that_is_raised_mixes_the_artists_shader_in(self, material):
        assert len(ours(material, "MIX_SHADER")) == 1
        shader(material).inputs["Metallic"].default_value = 0.5
        bpy.context.view_layer.update()
        assert len(ours(material, "MIX_SHADER")) == 2

    def test_a_new_link_is_followed(self, material):
        rgb = add(material, "RGB")
        link(material, rgb.outputs[0], shader(material).inputs["Base Color"])
        bpy.context.view_layer.update()
        assert ours(material, "GROUP")[0].inputs[0].links[0].from_node == rgb

    def test_a_deleted_node_of_ours_comes_back(self, material):
        material.node_tree.nodes.remove(ours(material, "GROUP")[0])
        bpy.context.view_layer.update()
        assert len(ours(material, "GROUP")) == 1

    def test_an_animated_value_is_followed(self, scene, material):
        base = shader(material).inputs["Base Color"]
        for frame, grey in ((1, 0.0), (11, 1.0)):
            base.default_value = (grey, grey, grey, 1)
            base.keyframe_insert("default_value", frame=frame)
        scene.frame_set(6)
        assert ours(material, "GROUP")[0].inputs[0].default_value[0] == pytest.approx(0.5)

    def test_remove_after_an_edit_keeps_the_edit(self, scene, material):
        shader(material).inputs["Metallic"].default_value = 0.5
        bpy.context.view_layer.update()
        remove.remove(scene, list(scene.objects))
        assert not ours(material)
        assert shader(material).inputs["Metallic"].default_value == 0.5


def test_a_material_shared_with_a_bake_of_another_order_is_refused(scene):
    material = principled()
    first, second = quad(scene, 0, 0, material), quad(scene, 2, 0, material, "Second")
    write(scene, LAYOUT, first)
    with pytest.raises(
        BakeError, match="'Quad' was baked with order 3 with no residual and shares"
    ):
        writeback.check(scene, [second], Layout(4))
    writeback.check(scene, [second], LAYOUT)
    writeback.check(scene, [first, second], Layout(4))


def test_a_linked_material_is_refused(scene, tmp_path):
    library = tmp_path / "library.blend"
    material = principled("Linked")
    bpy.data.libraries.write(str(library), {material})
    bpy.data.materials.remove(material)
    with bpy.data.libraries.load(str(library), link=True) as (_, wanted):
        wanted.materials = ["Linked"]
    obj = quad(scene, material=bpy.data.materials["Linked"])
    with pytest.raises(BakeError, match="Material 'Linked' of 'Quad' is linked"):
        writeback.check(scene, [obj], LAYOUT)
