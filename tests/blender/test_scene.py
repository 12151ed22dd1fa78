"""Which objects can be baked, in one sentence why not, and how an edited mesh is known."""

import bmesh
import bpy
import pytest
from mathutils import Matrix
from meshes import MIRRORED, add_instance, ball, cube, instance_of, place, receiver_of
from prt_baker.addon import scene as scene_arrays
from prt_baker.addon.prt.errors import BakeError


def lonely_edges():
    mesh = bpy.data.meshes.new("Edges")
    mesh.from_pydata([(0, 0, 0), (1, 0, 0)], [(0, 1)], [])
    return place(mesh)


def without_area():
    mesh = bpy.data.meshes.new("Flat")
    mesh.from_pydata([(0, 0, 0), (0.1, 0.2, 0.3), (0.2, 0.4, 0.6)], [], [(0, 1, 2)])
    return place(mesh)


def squashed():
    return place(cube(), matrix=Matrix.Diagonal((1, 0, 0, 1)))


def not_finite():
    obj = place(cube())
    obj.data.vertices[0].co.x = float("nan")
    obj.data.vertices[1].co.y = float("inf")
    obj.data.update()
    bpy.context.view_layer.update()
    return obj


def in_edit_mode():
    obj = place(cube())
    bpy.context.view_layer.objects.active = obj
    bpy.ops.object.mode_set(mode="EDIT")
    return obj


def disabled_in_renders():
    obj = place(cube())
    obj.hide_render = True
    return obj


def hidden_in_viewport():
    obj = place(cube())
    obj.hide_set(True)
    return obj


def in_no_collection():
    return bpy.data.objects.new("Object", cube())


def only_instanced():
    collection = bpy.data.collections.new("Group")
    obj = place(cube(), collection=collection)
    instance_of(collection)
    return obj


def an_instance():
    add_instance()
    return bpy.data.objects["Instance"]


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: place(bpy.data.meshes.new("Nothing")), "has no faces"),
        (lonely_edges, "has no faces"),
        (without_area, "only faces without area"),
        (squashed, "only faces without area"),
        (not_finite, r"NaN, infinite or too far away \(2 of 8\)"),
        (in_edit_mode, "Edit Mode"),
        (disabled_in_renders, "disabled in renders"),
        (hidden_in_viewport, "hidden in the viewport"),
        (in_no_collection, "not in the view layer"),
        (only_instanced, "Make Instances Real"),
        (an_instance, "Make Instances Real"),
        (lambda: place(bpy.data.cameras.new("Camera")), "is no mesh"),
        (lambda: place(None), "is no mesh"),
    ],
)
def test_what_cannot_be_baked_is_refused_in_one_sentence(scene, make, words):
    obj = make()
    with pytest.raises(BakeError, match=words) as refusal:
        scene_arrays.check_objects([obj])
    assert repr(obj.name) in str(refusal.value)
    assert "\n" not in str(refusal.value)
    if bpy.context.mode != "OBJECT":
        bpy.ops.object.mode_set(mode="OBJECT")


@pytest.mark.parametrize("linked", ["object", "mesh"])
def test_linked_data_is_refused(scene, tmp_path, linked):
    library = tmp_path / "library.blend"
    obj = place(cube(), "Linked")
    bpy.data.libraries.write(str(library), {obj})
    bpy.data.objects.remove(obj)
    with bpy.data.libraries.load(str(library), link=True) as (_, wanted):
        wanted.objects = ["Linked"]
    obj = wanted.objects[0]
    if linked == "mesh":
        obj = bpy.data.objects.new("Local", obj.data)
    scene.collection.objects.link(obj)
    with pytest.raises(BakeError, match="linked from another file"):
        scene_arrays.check_objects([obj])


@pytest.mark.parametrize("name", ["a b", "Größe 球", "../x"])
def test_any_name_and_any_scale_is_baked(scene, name):
    obj = place(cube(), name, MIRRORED)
    scene_arrays.check_objects([obj])
    assert receiver_of(obj).name == name


def test_nothing_to_bake_is_said(scene):
    with pytest.raises(BakeError, match="no mesh to bake"):
        scene_arrays.check_objects([])


def test_selected_meshes_are_baked_else_all_visible_ones(scene):
    first, second = place(cube(), "First"), place(cube(), "Second")
    place(bpy.data.meshes.new("Nothing"), "Empty Mesh").hide_render = True
    place(bpy.data.cameras.new("Camera"), "Camera").select_set(True)
    bpy.context.view_layer.update()
    assert set(scene_arrays.default_objects(bpy.context)) == {first, second}
    second.select_set(True)
    assert scene_arrays.default_objects(bpy.context) == [second]
    first.hide_render = True
    first.select_set(True)
    assert scene_arrays.default_objects(bpy.context) == [second]


def test_what_alone_is_selected_is_refused_with_its_reason(scene):
    place(cube(), "Fine")
    hidden = place(cube(), "Hidden")
    hidden.hide_render = True
    hidden.select_set(True)
    assert scene_arrays.default_objects(bpy.context) == [hidden]


def test_the_signature_is_of_shape_and_shading_alone(scene):
    obj = place(ball())
    before = scene_arrays.mesh_signature(obj)
    obj.data.attributes.new("_PRT_0", "FLOAT_COLOR", "POINT")
    obj.data.uv_layers.new(name="PRT")
    obj.data.materials.append(bpy.data.materials.new("Material"))
    obj.modifiers.new("Subdivision", "SUBSURF")
    assert scene_arrays.mesh_signature(obj) == before


@pytest.mark.parametrize("edit", ["move", "sharpen", "flatten", "delete", "custom normals"])
def test_the_signature_changes_with_what_is_baked(scene, edit):
    obj = place(ball())
    before = scene_arrays.mesh_signature(obj)
    EDITS[edit](obj.data)
    assert scene_arrays.mesh_signature(obj) != before


def move(mesh):
    mesh.vertices[5].co.z += 1e-4


def sharpen(mesh):
    mesh.edges[3].use_edge_sharp = True


def delete(mesh):
    grown = bmesh.new()
    grown.from_mesh(mesh)
    bmesh.ops.delete(grown, geom=grown.faces[:1], context="FACES_ONLY")
    grown.to_mesh(mesh)
    grown.free()


EDITS = {
    "move": move,
    "sharpen": sharpen,
    "flatten": lambda mesh: mesh.shade_flat(),
    "delete": delete,
    "custom normals": lambda mesh: mesh.normals_split_custom_set([(0, 0, 1)] * len(mesh.loops)),
}
