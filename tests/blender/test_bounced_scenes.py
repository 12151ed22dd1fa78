"""Colours that bounce: read from materials, baked into three channels, and what comes of it."""

from dataclasses import replace

import bpy
import numpy as np
import pytest
from bakes import add, link, output_of, principled, quad, shader
from prt_baker.addon import (
    albedo_bake,
    albedo_plan,
    albedo_state,
    bake,
    gltf,
    gltf_extras,
    properties,
    remove,
    scene_occluders,
    stale,
    stamp,
)
from prt_baker.addon.prt.errors import BakeError
from prt_baker.addon.prt.layout import Layout
from prt_baker.addon.prt.steps import value_of


def albedo(obj):
    """The albedo (F, 3, 3) of the only mesh of the scene."""
    bpy.context.view_layer.update()
    found = scene_occluders.read(bpy.context.evaluated_depsgraph_get(), with_albedo=True)
    assert len(found.albedo) == len(found.triangles) == 2 * len(obj.data.polygons)
    return found.albedo


def colours(kind, values):
    """A generated picture (H, W, 3), bottom row first, that is not encoded."""
    image = bpy.data.images.new(kind, values.shape[1], values.shape[0], float_buffer=True)
    pixels = np.ones((*values.shape[:2], 4), np.float32)
    pixels[..., :3] = values
    image.pixels.foreach_set(pixels.ravel())
    return image


def textured(image, extension="REPEAT"):
    material = principled()
    node = add(material, "TexImage")
    node.image, node.extension = image, extension
    link(material, node.outputs["Color"], shader(material).inputs["Base Color"])
    return material


def unwrapped(obj, scale=1.0):
    """``obj``, a square, with a UV map that lays a picture over it ``scale`` times."""
    layer = obj.data.uv_layers.new(name="Map")
    corners = np.float32([(0, 0), (1, 0), (1, 1), (0, 1)]) * scale
    layer.uv.foreach_set("vector", corners.ravel())
    return obj


def test_a_base_colour_without_its_metal(scene):
    material = principled(Base_Color=(0.5, 0.25, 0.125, 1))
    obj = quad(scene, material=material)
    np.testing.assert_allclose(albedo(obj), np.broadcast_to([0.5, 0.25, 0.125], (2, 3, 3)))
    shader(material).inputs["Metallic"].default_value = 0.75
    np.testing.assert_allclose(albedo(obj)[0, 0], [0.125, 0.0625, 0.03125])


def test_what_has_no_material_is_grey_and_what_is_not_finite_is_black(scene):
    obj = quad(scene)
    np.testing.assert_allclose(albedo(obj), 0.8)
    obj.data.materials.append(principled(Base_Color=(float("nan"), 5.0, -1.0, 1)))
    np.testing.assert_allclose(albedo(obj)[0, 0], [0, 1, 0])


def test_mixed_and_added_shaders(scene):
    material = principled(Base_Color=(1, 0, 0, 1))
    diffuse, mix = add(material, "BsdfDiffuse", Color=(0, 0, 1, 1)), add(material, "MixShader")
    mix.inputs[0].default_value = 0.25
    link(material, shader(material).outputs[0], mix.inputs[1])
    link(material, diffuse.outputs[0], mix.inputs[2])
    link(material, mix.outputs[0], output_of(material).inputs["Surface"])
    np.testing.assert_allclose(albedo(quad(scene, material=material))[0, 0], [0.75, 0, 0.25])


def test_a_picture_is_averaged_about_the_corners(scene):
    """A fine chequerboard reflects the mean of its squares; halves of a wall their own."""
    fine = np.indices((64, 64)).sum(axis=0) % 2
    board = colours("board", np.repeat(fine[..., None], 3, axis=2) * [0.8, 0.4, 0.2])
    obj = unwrapped(quad(scene, material=textured(board)), 7.3)
    assert np.abs(albedo(obj).mean(axis=(0, 1)) - [0.4, 0.2, 0.1]).max() < 0.06
    halves = np.zeros((4, 4, 3))
    halves[:, 2:] = 1, 0.5, 0
    obj.data.materials[0] = textured(colours("halves", halves))
    obj.data.uv_layers.remove(obj.data.uv_layers[0])
    found = albedo(unwrapped(obj))
    red = found[..., 0]
    assert red.min() < 0.3
    assert red.max() > 0.7
    np.testing.assert_allclose(found[..., 1], found[..., 0] / 2, atol=1e-6)


def test_a_picture_in_srgb_is_made_linear(scene):
    image = bpy.data.images.new("encoded", 4, 4)
    image.pixels.foreach_set(np.tile(np.float32([0.5, 0.5, 0.5, 1]), 16))
    obj = unwrapped(quad(scene, material=textured(image)))
    np.testing.assert_allclose(albedo(obj), 0.214, atol=2e-3)


def test_a_colour_attribute(scene):
    material = principled()
    node = add(material, "VertexColor")
    node.layer_name = "Paint"
    link(material, node.outputs["Color"], shader(material).inputs["Base Color"])
    obj = quad(scene, material=material)
    paint = obj.data.color_attributes.new("Paint", "FLOAT_COLOR", "POINT")
    values = np.float32([(1, 0, 0, 1), (0, 1, 0, 1), (0, 0, 1, 1), (0.5, 0.5, 0.5, 1)])
    paint.data.foreach_set("color", values.ravel())
    found = {tuple(row) for row in albedo(obj).reshape(-1, 3).round(3).tolist()}
    assert found == {(1, 0, 0), (0, 1, 0), (0, 0, 1), (0.5, 0.5, 0.5)}


def test_other_nodes_are_baked_by_cycles_once_and_leave_nothing(scene, monkeypatch):
    """A gamma node, of which we know what it does."""

    material = principled()
    gamma = add(material, "Gamma", Color=(0.5, 0.25, 1.0, 1), Gamma=2.0)
    link(material, gamma.outputs[0], shader(material).inputs["Base Color"])
    shader(material).inputs["Specular IOR Level"].default_value = 0
    obj = quad(scene, material=material)
    kinds = ("scenes", "meshes", "objects", "materials", "images")
    before = [set(getattr(bpy.data, kind).keys()) for kind in kinds]
    np.testing.assert_allclose(albedo(obj)[1, 2], [0.25, 0.0625, 1.0], atol=2e-3)
    assert [set(getattr(bpy.data, kind).keys()) for kind in kinds] == before
    assert bpy.context.view_layer.objects.active is None or obj.name in scene.objects
    asked = []
    monkeypatch.setattr(albedo_bake, "_baked", lambda mesh, _: asked.append(mesh) or np.zeros(0))
    np.testing.assert_allclose(albedo(obj)[1, 2], [0.25, 0.0625, 1.0], atol=2e-3)
    assert not asked
    gamma.inputs["Gamma"].default_value = 1.0
    monkeypatch.undo()
    np.testing.assert_allclose(albedo(obj)[1, 2], [0.5, 0.25, 1.0], atol=2e-3)


def test_what_shines_is_named(scene):
    assert not albedo_plan.read(principled()).emits
    glowing = principled("Glow", Emission_Strength=2.0)
    assert albedo_plan.read(glowing).emits
    obj = quad(scene, material=glowing, name="Lamp")
    bpy.context.view_layer.update()
    found = scene_occluders.read(bpy.context.evaluated_depsgraph_get(), with_albedo=True)
    assert found.emitters == (obj.name,)
    scene.world = bpy.data.worlds.new("World")
    settings = replace(properties.settings(scene), bounces=1, rays=16)
    report = value_of(bake.bake(scene.name, [obj.name], settings))
    assert report["notes"] == ["'Lamp' shines, but the bake holds the light of the world alone"]


@pytest.fixture
def corner(scene):
    """A white floor beside a wall, both subdivided, the wall's material to be chosen."""
    scene.world = bpy.data.worlds.new("World")
    white, wall = principled("White", Base_Color=(0.8, 0.8, 0.8, 1)), principled("Wall")
    objects = []
    for material, place, turn in ((white, (0, 0, 0), 0), (wall, (1, 0, 1), -1.5707963)):
        bpy.ops.mesh.primitive_grid_add(
            x_subdivisions=8, y_subdivisions=8, size=2, location=place, rotation=(0, turn, 0)
        )
        bpy.context.object.data.materials.append(material)
        objects.append(bpy.context.object)
    return objects


def test_a_coloured_wall_takes_three_channels_and_a_grey_one_one(scene, corner):
    settings = replace(properties.settings(scene), bounces=2, rays=64)
    names = [obj.name for obj in corner]
    shader(corner[1].data.materials[0]).inputs["Base Color"].default_value = (0.5, 0.5, 0.5, 1)
    value_of(bake.bake(scene.name, names, settings))
    assert [stamp.read(obj).channels for obj in corner] == [1, 1]
    shader(corner[1].data.materials[0]).inputs["Base Color"].default_value = (0.8, 0.1, 0.1, 1)
    report = value_of(bake.bake(scene.name, names, settings))
    marks = [stamp.read(obj) for obj in corner]
    assert [(mark.channels, mark.bounces) for mark in marks] == [(3, 2), (3, 2)]
    assert report["objects"][0]["bounces"] == 2
    values = np.empty(4 * len(corner[0].data.loops), np.float32)
    by_domain = corner[0].data.attributes["_PRT_0"]
    values = np.empty(4 * len(by_domain.data), np.float32)
    by_domain.data.foreach_get("color", values)
    red, green, blue = values.reshape(-1, 4)[:, :3].mean(axis=0)
    assert red > 1.02 * green
    assert green == pytest.approx(blue, rel=1e-4)


def test_without_bounces_the_bake_is_what_it_was(scene, corner):
    """A coloured wall is nothing to a bake of shadows."""
    settings = replace(properties.settings(scene), rays=64)
    value_of(bake.bake(scene.name, [obj.name for obj in corner], settings))
    assert [stamp.read(obj).channels for obj in corner] == [1, 1]
    assert [stamp.read(obj).bounces for obj in corner] == [0, 0]


def test_order_5_in_colour_is_refused_before_baking(scene, corner):
    shader(corner[1].data.materials[0]).inputs["Base Color"].default_value = (0.8, 0.1, 0.1, 1)
    settings = replace(properties.settings(scene), bounces=1, order=5)
    with pytest.raises(BakeError, match=r"3 channels .* or no bounces"):
        value_of(bake.bake(scene.name, [obj.name for obj in corner], settings))
    assert not any(stamp.KEY in obj for obj in corner)


def test_verify_follows_the_light_too(scene, corner):
    shader(corner[1].data.materials[0]).inputs["Base Color"].default_value = (0.8, 0.1, 0.1, 1)
    settings = replace(properties.settings(scene), bounces=2, rays=512)
    names = [obj.name for obj in corner]
    value_of(bake.bake(scene.name, names, settings))
    checked = replace(settings, bounces=0, verify_points=40, verify_rays=4096)
    value_of(bake.verify(scene.name, names, checked))
    assert stamp.read(corner[0]).measured_error < 0.04


@pytest.fixture
def bounced(scene, corner):
    """The corner, baked together with one bounce; a function tells which of it is shown."""
    settings = replace(properties.settings(scene), bounces=1, rays=16)
    value_of(bake.bake(scene.name, [obj.name for obj in corner], settings))

    def shown():
        bpy.context.view_layer.update()
        switches = [bool(obj[stamp.SWITCH]) for obj in corner]
        reasons = [stale.reason(obj, stamp.read(obj)) for obj in corner]
        assert [reason is None for reason in reasons] == switches
        return all(switches), reasons[0]

    assert shown() == (True, None)
    return shown


def test_a_recoloured_neighbour_makes_a_bounced_bake_stale_until_it_is_back(corner, bounced):
    colour = shader(corner[1].data.materials[0]).inputs["Base Color"]
    before = tuple(colour.default_value)
    colour.default_value = (0.1, 0.2, 0.9, 1)
    reason = f"{corner[1].name} has other colours than those that bounced off it: bake again"
    assert bounced() == (False, reason)
    colour.default_value = before
    assert bounced() == (True, None)


@pytest.mark.parametrize("owner", ["OBJECT", "DATA"])
def test_another_material_is_another_colour(corner, bounced, owner):
    slot = corner[1].material_slots[0]
    before = slot.material
    slot.link = owner
    slot.material = principled(Base_Color=(0.1, 0.9, 0.2, 1))
    assert not bounced()[0]
    slot.material = before
    assert bounced()[0]


def test_what_bounces_no_light_makes_no_bake_stale(scene, corner, bounced, monkeypatch):
    """Roughness, names, other objects' colours, and what only moves, which takes no look."""
    its = shader(corner[1].data.materials[0])
    its.inputs["Roughness"].default_value = 0.1
    its.location = 5, 5
    new = quad(scene, x=9, material=principled(Base_Color=(1, 0, 0, 1)))
    assert bounced()[0]
    looks = []
    monkeypatch.setattr(albedo_state, "recoloured", lambda *a: looks.append(a))
    new.location.x = 12
    bpy.context.view_layer.update()
    assert looks == []


def test_painted_corners_make_a_bounced_bake_stale(scene, corner):
    material = corner[1].data.materials[0]
    layer = corner[1].data.color_attributes.new("Paint", "FLOAT_COLOR", "CORNER")
    node = add(material, "VertexColor")
    node.layer_name = "Paint"
    link(material, node.outputs["Color"], shader(material).inputs["Base Color"])
    settings = replace(properties.settings(scene), bounces=1, rays=16)
    value_of(bake.bake(scene.name, [obj.name for obj in corner], settings))
    bpy.context.view_layer.update()
    assert corner[0][stamp.SWITCH]
    layer = corner[1].data.color_attributes["Paint"]
    layer.data.foreach_set("color", np.tile(np.float32([1, 0, 0, 1]), len(layer.data)))
    corner[1].data.update()
    bpy.context.view_layer.update()
    assert not corner[0][stamp.SWITCH]


def test_nodes_that_only_cycles_can_read_are_compared_too(scene, corner):
    material = corner[1].data.materials[0]
    noise = add(material, "TexNoise")
    link(material, noise.outputs["Color"], shader(material).inputs["Base Color"])
    assert albedo_plan.read(material).colors is None
    before = albedo_state.of([corner[1]])
    noise.inputs["Scale"].default_value = 9
    assert albedo_state.of([corner[1]]) != before


def test_what_bounced_is_forgotten_with_the_last_bake(scene, corner, bounced):
    assert albedo_state.KEY in scene
    remove.remove(scene, [corner[0]])
    assert albedo_state.KEY in scene
    remove.remove(scene, corner)
    assert albedo_state.KEY not in scene


@pytest.mark.parametrize("bounces", [False, True])
def test_gltf_says_whether_bounces_are_inside(bounces):
    packing = Layout(3, 3 if bounces else 1)
    stored = {"layout": list(packing.slots), "scale": 1}
    written = gltf._description(packing, np.eye(3), bounces, stored)
    assert written["includes"] == "visibility, cosine / pi" + ", bounces" * bounces
    assert gltf_extras.read_bake(written).bounces is bounces
