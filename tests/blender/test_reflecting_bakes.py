"""Whole bakes with reflections: they follow the world and the artist, and go with the bake."""

from math import radians

import bpy
import numpy as np
import pytest
from bakes import principled, quad, shader
from prt_baker.addon import bake, light_state, materials, nodes, reflections, remove
from prt_baker.addon.prt.job import Settings
from prt_baker.addon.prt.specular import sheet
from prt_baker.addon.prt.steps import value_of


@pytest.fixture
def scene(registered):
    bpy.ops.wm.read_factory_settings(use_empty=True)
    return bpy.context.scene


def switched(material):
    """The inputs of its group that reflects."""
    (group,) = (node for node in material.node_tree.nodes if node.type == "GROUP")
    return group.inputs


def baked(scene, names, **settings):
    return value_of(bake.bake(scene.name, names, Settings(rays=16, fit=False, **settings)))


@pytest.fixture
def sky(scene):
    scene.world = bpy.data.worlds.new("World")
    if bpy.app.version < (5, 0):
        scene.world.use_nodes = True
    tree = scene.world.node_tree
    background = next(n for n in tree.nodes if n.type == "BACKGROUND")
    mapping, place = (tree.nodes.new(f"ShaderNode{n}") for n in ("Mapping", "TexCoord"))
    texture = tree.nodes.new("ShaderNodeTexEnvironment")
    texture.image = bpy.data.images.new("Sky", 64, 32, float_buffer=True)
    texture.image.colorspace_settings.name = "Non-Color"
    texture.image.pixels[:] = np.random.default_rng(0).random(64 * 32 * 4).tolist()
    texture.image.pack()
    for source, target in (
        (place.outputs["Generated"], mapping.inputs[0]),
        (mapping.outputs[0], texture.inputs[0]),
        (texture.outputs[0], background.inputs[0]),
    ):
        tree.links.new(source, target)
    return mapping


def test_grey_diffuse_surfaces_get_nothing_new(scene, sky):
    material = principled(Base_Color=(0.5, 0.5, 0.5, 1), Specular_IOR_Level=0)
    obj = quad(scene, material=material)
    without = baked(scene, [obj.name])
    tree = nodes.groups()[0]
    before = [(n.type, n.name) for n in tree.nodes]
    having = baked(scene, [obj.name], reflections=True)
    assert "reflections" not in having["seconds"]
    assert reflections.current() is None
    assert [(n.type, n.name) for n in nodes.groups()[0].nodes] == before
    assert without["objects"][0]["rays"] == having["objects"][0]["rays"]


def test_it_turns_with_the_world_and_goes_with_the_bake(scene, sky, tmp_path):
    obj = quad(scene, material=principled(Metallic=1, Roughness=0.3))
    images_before = set(bpy.data.images.keys())
    report = baked(scene, [obj.name], reflections=True)
    assert report["seconds"]["reflections"] > 0
    image = reflections.current()
    assert image.packed_file is not None
    assert image.colorspace_settings.name == "Non-Color"
    sky.inputs["Rotation"].default_value[2] = radians(90)
    bpy.context.view_layer.update()
    row = nodes.groups()[0].nodes["Turn 0"].inputs[1].default_value
    assert tuple(row) == pytest.approx((0, -1, 0), abs=1e-6)
    assert reflections.current() == image
    path = str(tmp_path / "kept.blend")
    bpy.ops.wm.save_as_mainfile(filepath=path)
    bpy.ops.wm.open_mainfile(filepath=path)
    scene = bpy.context.scene
    kept = reflections.current()
    assert kept.has_data or kept.pixels[0] >= 0
    assert nodes.groups()[0][nodes.REFLECTED] == kept
    assert light_state.read(scene).rotation[0] == pytest.approx((0, -1, 0), abs=1e-6)
    remove.remove(scene, list(scene.objects))
    assert set(bpy.data.images.keys()) == images_before
    assert not nodes.groups()


def test_another_hdri_is_reflected_at_once(scene, sky):
    obj = quad(scene, material=principled(Metallic=1))
    baked(scene, [obj.name], reflections=True)
    texture = sky.outputs[0].links[0].to_node
    other = bpy.data.images.new("Other", 64, 32, float_buffer=True)
    other.colorspace_settings.name = "Non-Color"
    other.pixels[:] = [0.25] * (64 * 32 * 4)
    other.pack()
    texture.image = other
    bpy.context.view_layer.update()
    (kept,) = (image for image in bpy.data.images if reflections.TAG in image)
    width, height = kept.size
    pixels = np.array(kept.pixels[:]).reshape(height, width, 4)
    known = reflections.of(kept).sheet
    up = sheet.radiance(known, pixels, np.array([[0, 0.6, 0.8]]), 0.5)
    assert up == pytest.approx(np.full((1, 3), 0.25), rel=1e-3)
    assert all(node.image == kept for node in nodes.groups()[0].nodes if node.type == "TEX_IMAGE")


def test_a_material_that_becomes_shiny_is_followed(scene, sky):
    made = principled(Specular_IOR_Level=0), principled(Metallic=1)
    objects = [quad(scene, k, material=one, name=str(k)) for k, one in enumerate(made)]
    baked(scene, [obj.name for obj in objects], reflections=True)
    assert [materials.reflects(one) for one in made] == [False, True]
    assert len(nodes.groups()) == 2
    shader(made[0]).inputs["Metallic"].default_value = 0.5
    bpy.context.view_layer.update()
    nodes.free_unused()
    assert len(nodes.groups()) == 1


def test_switches_stay_where_the_artist_put_them(scene, sky):
    material = principled(Metallic=1)
    obj = quad(scene, material=material)
    baked(scene, [obj.name], reflections=True)
    switched(material)["Rough Look-up"].default_value = 0
    switched(material)["Energy Compensation"].default_value = 0.5
    baked(scene, [obj.name], reflections=True, residual=False)
    other = material.node_tree.nodes.new("ShaderNodeRGB")
    material.node_tree.links.new(other.outputs[0], shader(material).inputs["Base Color"])
    bpy.context.view_layer.update()
    assert switched(material)["Base Color"].is_linked
    assert switched(material)["Rough Look-up"].default_value == 0
    assert switched(material)["Energy Compensation"].default_value == 0.5
    fresh = principled(Metallic=1)
    baked(scene, [quad(scene, 2, material=fresh).name], reflections=True)
    assert switched(fresh)["Rough Look-up"].default_value == 1


def test_update_light_cuts_the_baked_lamps_out_again(scene, sky):
    texture = sky.outputs[0].links[0].to_node
    pixels = np.full((32, 64, 4), 0.5, np.float32)
    pixels[24:26, 20:22, :3] = 500
    texture.image.pixels.foreach_set(pixels.ravel())
    texture.image.pack()
    obj = quad(scene, material=principled(Metallic=1))
    baked(scene, [obj.name], reflections=True, peaks=2)
    before = reflections.of(reflections.current())
    assert len(before.peaks) == 1
    sky.inputs["Rotation"].default_value[2] = radians(90)
    bpy.context.view_layer.update()
    value_of(bake.update_light(scene.name))
    after = reflections.of(reflections.current())
    assert after.peaks[0].direction == pytest.approx(before.peaks[0].direction, abs=1e-4)
    assert after.peaks[0].irradiance == pytest.approx(before.peaks[0].irradiance, rel=1e-3)
    pixels[:, :, :3] = pixels[::-1, :, :3]
    texture.image = bpy.data.images.new("Other", 64, 32, float_buffer=True)
    texture.image.colorspace_settings.name = "Non-Color"
    texture.image.pixels.foreach_set(pixels.ravel())
    texture.image.pack()
    bpy.context.view_layer.update()
    assert not reflections.of(reflections.current()).peaks, "its lamps have no baked shadow"
