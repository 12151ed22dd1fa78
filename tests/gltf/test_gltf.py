"""A bake in a .glb: a reader that knows glTF alone sees the light that the .blend shows."""

import bpy
import numpy as np
import pytest
from glb import Glb
from gltf_laws import TURN, Y_UP, assert_same_light
from gltf_scenes import NODES, export, mirrored, monkey, plain, rotated, sheared
from mathutils import Euler
from prt_baker.addon import gltf_export


@pytest.mark.parametrize("make", NODES)
@pytest.mark.parametrize("domain", ["POINT", "CORNER"])
def test_a_node_shows_the_light_of_the_blend_standing_and_turned(scene, bake, out, make, domain):
    name = make().name
    transfer = bake(bpy.data.objects[name], domain=domain)
    gltf_export.write(str(out), [name])
    glb = Glb(out)
    world = glb.world(name)
    assert_same_light(glb, name, transfer, world, np.eye(3))
    assert_same_light(glb, name, transfer, Y_UP @ TURN @ Y_UP.T @ world, TURN)


@pytest.mark.parametrize("make", NODES)
def test_an_unmoved_node_needs_no_turn(scene, bake, out, make):
    obj = make()
    bake(obj)
    gltf_export.write(str(out))
    glb = Glb(out)
    matrix = np.reshape(glb.prt(obj.name)["matrix"], (3, 3)).T
    np.testing.assert_allclose(matrix, glb.world(obj.name), atol=1e-9)


@pytest.mark.parametrize("make", [plain, rotated, mirrored, sheared])
def test_matrix_is_that_of_the_bake_in_the_frame_of_gltf(scene, bake, out, make):
    obj = make()
    bake(obj)
    gltf_export.write(str(out))
    matrix = np.reshape(Glb(out).prt(obj.name)["matrix"], (3, 3)).T
    blender = np.array(obj.matrix_world.to_3x3())
    np.testing.assert_allclose(matrix, Y_UP @ blender @ Y_UP.T, atol=1e-5)


@pytest.mark.parametrize(("order", "channels"), [(2, 1), (5, 1), (2, 3), (4, 3)])
def test_every_layout_arrives(scene, bake, out, order, channels):
    obj = mirrored()
    transfer = bake(obj, order=order, channels=channels, turns=1)
    gltf_export.write(str(out))
    glb = Glb(out)
    assert_same_light(glb, obj.name, transfer, glb.world(obj.name), np.eye(3))
    prt = glb.prt(obj.name)
    assert (prt["version"], prt["frame"], prt["scale"]) == (1, "world", 1)
    assert "turns" not in prt


def test_modifiers_and_shared_meshes_arrive_each_with_its_own(scene, bake, out):
    first = monkey("First")
    first.modifiers.new("Subdivision", "SUBSURF")
    second = first.copy()
    second.name, second.location = "Second", (3, 0, 0)
    third = monkey("Third")
    third.data = first.data
    for obj in (second, third):
        if obj.name not in scene.objects:
            scene.collection.objects.link(obj)
    second.modifiers["Subdivision"].levels = 2
    baked = {obj.name: bake(obj, by_modifier=True) for obj in (first, second, third)}
    gltf_export.write(str(out), list(baked))
    glb = Glb(out)
    assert len({glb.nodes[name]["mesh"] for name in baked}) == 3
    for name, transfer in baked.items():
        assert_same_light(glb, name, transfer, glb.world(name), np.eye(3))


def test_an_animated_object_says_where_it_was_baked(scene, bake, out):
    """Without Use Current Frame the exporter writes nodes as they stand at frame 0."""
    obj = monkey()
    for frame, angle in ((0, 0), (20, 1.5)):
        obj.rotation_euler.z = angle
        obj.keyframe_insert("rotation_euler", frame=frame)
    scene.frame_set(20)
    transfer = bake(obj)
    glb = export(out)
    np.testing.assert_allclose(glb.world(obj.name), np.eye(3))
    back = np.array(Euler((0, 0, -1.5)).to_matrix())
    assert_same_light(glb, obj.name, transfer, glb.world(obj.name), back)
