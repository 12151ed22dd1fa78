"""The scene as arrays: what is read is what Blender shows and renders, in the world's space."""

from collections import Counter
from math import pi

import bmesh
import bpy
import numpy as np
import pytest
from mathutils import Matrix
from prt_baker.addon import scene as scene_arrays
from prt_baker.addon.prt.errors import BakeError
from prt_baker.addon.scene_visibility import Rendered

MIRRORED = Matrix.Diagonal((-1, 2, 0.5, 1))
SHEARED = Matrix(((1, 0.7, 0, 3), (0, 1, 0.2, -2), (0, 0, 1.5, 1), (0, 0, 0, 1)))
TURNED = Matrix.Translation((5, 0, 0)) @ Matrix.Rotation(1, 4, (1, 2, 3))


def mesh_of(make, name="Mesh", **options):
    """A mesh by one of bmesh's operators."""
    mesh = bpy.data.meshes.new(name)
    grown = bmesh.new()
    make(grown, **options)
    grown.to_mesh(mesh)
    grown.free()
    return mesh


def cube(name="Cube"):
    return mesh_of(bmesh.ops.create_cube, name, size=2)


def ball(smooth=True):
    mesh = mesh_of(bmesh.ops.create_icosphere, "Ball", subdivisions=3, radius=1)
    mesh.shade_smooth() if smooth else mesh.shade_flat()
    return mesh


def place(data, name="Object", matrix=None, collection=None):
    """An object where ``matrix`` puts it; by a parent, because an object alone can't be sheared."""
    obj = bpy.data.objects.new(name, data)
    if matrix is not None:
        obj.parent = bpy.data.objects.new("Parent", None)
        obj.matrix_parent_inverse = matrix
    (collection or bpy.context.scene.collection).objects.link(obj)
    bpy.context.view_layer.update()
    return obj


def receiver_of(obj):
    return scene_arrays.read_receivers(bpy.context.evaluated_depsgraph_get(), [obj])[0]


def occluders():
    return scene_arrays.read_occluders(bpy.context.evaluated_depsgraph_get())


def geometric_normals(vertices, triangles):
    a, b, c = (vertices[triangles[:, i]] for i in range(3))
    return np.cross(b - a, c - a)


@pytest.mark.parametrize("matrix", [Matrix(), MIRRORED, SHEARED, TURNED])
@pytest.mark.parametrize("make", [cube, ball, lambda: ball(smooth=False)])
def test_normals_point_out_of_every_closed_mesh(scene, make, matrix):
    obj = place(make(), matrix=matrix)
    got = receiver_of(obj)
    faces = geometric_normals(got.vertices, got.triangles)
    centres = got.vertices[got.triangles].mean(axis=1) - np.array(matrix.translation)
    assert (np.einsum("fk,fk->f", faces, centres) > 0).all()
    shading = got.normals[got.triangle_corners if got.domain == "CORNER" else got.triangles]
    assert (np.einsum("fck,fk->fc", shading, faces) > 0).all()
    np.testing.assert_allclose(np.linalg.norm(got.normals, axis=1), 1, atol=1e-6)


@pytest.mark.parametrize("matrix", [MIRRORED, SHEARED, TURNED])
def test_shading_normals_stay_perpendicular_to_the_surface(scene, matrix):
    mesh = ball()
    here = receiver_of(place(mesh, matrix=matrix))
    local = receiver_of(place(mesh)).normals.astype(np.float64)
    for other in np.eye(3):
        tangents = np.cross(local, other) @ np.array(matrix)[:3, :3].T
        assert np.abs(np.einsum("vk,vk->v", tangents, here.normals)).max() < 1e-6


def test_a_flattened_mesh_still_has_unit_normals(scene):
    got = receiver_of(place(ball(), matrix=Matrix.Diagonal((1, 1, 0, 1))))
    np.testing.assert_allclose(np.linalg.norm(got.normals, axis=1), 1, atol=1e-6)


@pytest.mark.parametrize("make", [cube, ball])
def test_triangles_are_their_corners_vertices(scene, make):
    got = receiver_of(place(make(), matrix=MIRRORED))
    np.testing.assert_array_equal(got.corner_vertices[got.triangle_corners], got.triangles)
    for array in (got.triangles, got.triangle_corners, got.corner_vertices):
        assert array.dtype == np.int32
    assert got.vertices.dtype == np.float64
    assert got.normals.dtype == np.float32


def test_smooth_shading_is_per_vertex_and_any_sharp_edge_per_corner(scene):
    obj = place(ball())
    got = receiver_of(obj)
    assert got.domain == "POINT"
    assert len(got.normals) == len(obj.data.vertices)
    obj.data.edges[0].use_edge_sharp = True
    obj.data.update()
    got = receiver_of(obj)
    assert got.domain == "CORNER"
    assert len(got.normals) == len(obj.data.loops)


def test_polygons_of_many_corners_keep_their_area(scene):
    mesh = bpy.data.meshes.new("Arrow")  # concave: a fan would cover too much
    outline = [(0, 0, 0), (2, -1, 0), (1, 0, 0), (2, 1, 0)]
    circle = [(5 + np.cos(a), np.sin(a), 0) for a in np.arange(7) * 2 * pi / 7]
    mesh.from_pydata(outline + circle, [], [range(4), range(4, 11)])
    got = receiver_of(place(mesh))
    area = np.linalg.norm(geometric_normals(got.vertices, got.triangles), axis=1).sum() / 2
    assert area == pytest.approx(1 + 7 / 2 * np.sin(2 * pi / 7), rel=1e-5)


def test_modifiers_and_shape_keys_are_read_evaluated(scene):
    obj = place(cube())
    obj.modifiers.new("Subdivision", "SUBSURF").levels = 2
    assert len(receiver_of(obj).vertices) == 98
    obj.modifiers.clear()
    obj.shape_key_add(name="Basis")
    key = obj.shape_key_add(name="Up")
    for point in key.data:
        point.co.z += 3
    key.value = 0.5
    bpy.context.view_layer.update()
    assert receiver_of(obj).vertices[:, 2].max() == pytest.approx(2.5)


def test_world_positions_keep_what_float32_would_lose(scene):
    obj = place(ball(), matrix=Matrix.Translation((65536, 0, 0)))
    local = np.array([v.co for v in obj.data.vertices], np.float64)
    np.testing.assert_array_equal(receiver_of(obj).vertices[:, 0] - 65536, local[:, 0])


@pytest.mark.parametrize("kind", ["text", "curve", "surface", "metaball", "nodes", "instance"])
def test_everything_with_faces_casts_a_shadow_once(scene, kind):
    expected = ADD[kind]()
    vertices, triangles, repairs = occluders()
    assert len(triangles) == expected
    assert len(vertices) == triangles.max() + 1
    assert not repairs["dropped_triangles"]


def add_text():
    bpy.ops.object.text_add()
    bpy.context.object.data.extrude = 0.1
    return converted_triangles(bpy.context.object)


def add_curve():
    bpy.ops.curve.primitive_bezier_circle_add()
    bpy.context.object.data.bevel_depth = 0.1
    return converted_triangles(bpy.context.object)


def add_surface():
    bpy.ops.surface.primitive_nurbs_surface_sphere_add()
    return converted_triangles(bpy.context.object)


def add_metaball():
    bpy.ops.object.metaball_add()
    return converted_triangles(bpy.context.object)


def converted_triangles(obj):
    evaluated = obj.evaluated_get(bpy.context.evaluated_depsgraph_get())
    mesh = evaluated.to_mesh()
    mesh.calc_loop_triangles()
    count = sum(t.area > 1e-12 for t in mesh.loop_triangles)
    evaluated.to_mesh_clear()
    return count


def add_nodes():
    scattered(place(mesh_of(bmesh.ops.create_grid, x_segments=1, y_segments=1, size=1)))
    return 4 * 12


def scattered(obj, source=None):
    """Cubes, or instances of ``source``, on the vertices of ``obj``."""
    tree = bpy.data.node_groups.new("Scatter", "GeometryNodeTree")
    for in_out in ("INPUT", "OUTPUT"):
        tree.interface.new_socket("Geometry", in_out=in_out, socket_type="NodeSocketGeometry")
    start, end = tree.nodes.new("NodeGroupInput"), tree.nodes.new("NodeGroupOutput")
    on_points = tree.nodes.new("GeometryNodeInstanceOnPoints")
    if source is None:
        thing = tree.nodes.new("GeometryNodeMeshCube").outputs["Mesh"]
    else:
        info = tree.nodes.new("GeometryNodeObjectInfo")
        info.inputs["Object"].default_value = source
        info.inputs["As Instance"].default_value = True
        thing = info.outputs["Geometry"]
    tree.links.new(start.outputs[0], on_points.inputs["Points"])
    tree.links.new(thing, on_points.inputs["Instance"])
    tree.links.new(on_points.outputs[0], end.inputs[0])
    obj.modifiers.new("Scatter", "NODES").node_group = tree
    bpy.context.view_layer.update()


def instance_of(collection, name="Instance", matrix=None):
    empty = place(None, name, matrix)
    empty.instance_type, empty.instance_collection = "COLLECTION", collection
    bpy.context.view_layer.update()
    return empty


def add_instance():
    inner, outer = bpy.data.collections.new("Inner"), bpy.data.collections.new("Outer")
    place(cube(), collection=inner)
    nested = place(None, collection=outer)
    nested.instance_type, nested.instance_collection = "COLLECTION", inner
    instance_of(outer)
    return 12


ADD = {
    "text": add_text,
    "curve": add_curve,
    "surface": add_surface,
    "metaball": add_metaball,
    "nodes": add_nodes,
    "instance": add_instance,
}


def test_mirrored_instances_are_closed_outwards(scene):
    collection = bpy.data.collections.new("Inner")
    place(ball(), collection=collection)
    instance_of(collection, matrix=MIRRORED)
    vertices, triangles, _ = occluders()
    faces = geometric_normals(vertices, triangles)
    assert (np.einsum("fk,fk->f", faces, vertices[triangles].mean(axis=1)) > 0).all()


def test_shared_meshes_are_read_once(scene, monkeypatch):
    mesh = ball()
    for i in range(20):
        place(mesh, matrix=Matrix.Translation((3 * i, 0, 0)))
    read = []
    once = scene_arrays._read_occluder
    monkeypatch.setattr(scene_arrays, "_read_occluder", lambda o: read.append(o) or once(o))
    _, triangles, _ = occluders()
    assert len(read) == 1
    assert len(triangles) == 20 * len(mesh.polygons)


class Listing(bpy.types.RenderEngine):
    """Renders nothing; notes what a render would show."""

    bl_idname, bl_label = "PRT_TEST_LISTING", "Listing"
    seen: Counter = Counter()

    def render(self, depsgraph):
        for instance in depsgraph.object_instances:
            if instance.object.type == "MESH" and instance.show_self:
                type(self).seen[label(instance)] += 1


def label(instance):
    return instance.object.name, instance.parent.name if instance.parent else ""


def rendered(scene):
    """How often a render shows which mesh of which instancer."""
    bpy.utils.register_class(Listing)
    Listing.seen = Counter()
    try:
        scene.render.engine = Listing.bl_idname
        scene.render.resolution_x = scene.render.resolution_y = 8
        scene.camera = place(bpy.data.cameras.new("Camera"), "Camera")
        bpy.ops.render.render()
    finally:
        bpy.utils.unregister_class(Listing)
    return Listing.seen


def crowded(scene):
    """Things that viewport and render show, or only one of them, or none."""
    mesh, child = cube(), bpy.data.collections.new("Child")
    group, off = bpy.data.collections.new("Group"), bpy.data.collections.new("Off")
    scene.collection.children.link(off)
    group.children.link(child)
    off.hide_render = child.hide_render = True
    place(mesh, "Seen")
    place(mesh, "Disabled").hide_render = True
    place(mesh, "In Off", collection=off)
    place(mesh, "In Group", collection=group)
    place(mesh, "Disabled In Group", collection=group).hide_render = True
    place(mesh, "In Child", collection=child)
    instance_of(group, "Shown")
    instance_of(group, "Hidden").hide_render = True
    instance_of(off, "Of Off")
    nested = bpy.data.collections.new("Nested")
    deep = place(None, "Deep", collection=nested)
    deep.instance_type, deep.instance_collection = "COLLECTION", group
    instance_of(nested, "Outer")
    scattered(place(cube(), "Scattering"), bpy.data.objects["Disabled"])
    scattered(place(cube(), "Scattering Cubes"))
    place(mesh, "Not In Viewport").hide_set(True)
    parent = place(cube("Parent"), "Parent")
    parent.instance_type, parent.show_instancer_for_render = "VERTS", False
    for name in ("On Vertices", "Disabled On Vertices"):
        place(mesh, name).parent = parent
    bpy.data.objects["Disabled On Vertices"].hide_render = True
    bpy.context.view_layer.update()


def test_occluders_are_what_viewport_and_render_show(scene):
    crowded(scene)
    depsgraph = bpy.context.evaluated_depsgraph_get()
    ours = Rendered(depsgraph.view_layer)
    shown, cast = Counter(), Counter()
    for instance in depsgraph.object_instances:
        if instance.object.type == "MESH":
            shown[label(instance)] += 1
            cast[label(instance)] += ours.casts_shadow(instance)
    both = shown & rendered(scene)
    assert +cast == both
    assert len(both) < len(shown)


def test_what_casts_no_shadow_is_no_occluder(scene):
    place(cube(), "One")
    collection = bpy.data.collections.new("Group")
    place(cube(), "Two", collection=collection)
    empty = instance_of(collection)
    assert len(occluders()[1]) == 24
    empty.visible_shadow = False
    assert len(occluders()[1]) == 12
    bpy.data.objects["One"].visible_shadow = False
    assert len(occluders()[1]) == 0


def test_broken_triangles_stop_no_light_and_are_counted(scene):
    obj = place(cube())
    obj.data.vertices[0].co.x = float("nan")
    flat = bpy.data.meshes.new("Flat")
    flat.from_pydata([(0, 0, 0), (1, 1, 1), (2, 2, 2)], [], [(0, 1, 2)])
    place(flat)
    bpy.context.view_layer.update()
    vertices, triangles, repairs = occluders()
    touching = sum(0 in corner.vertices for corner in triangulation(obj))
    assert repairs == {"dropped_triangles": touching, "zero_area_triangles": 1}
    assert len(triangles) == 12 - touching
    assert np.isfinite(vertices).all()


def test_an_object_at_no_place_stops_no_light(scene):
    place(cube(), matrix=Matrix.Translation((float("nan"), 0, 0)))
    place(cube())
    vertices, triangles, repairs = occluders()
    assert repairs["dropped_triangles"] == len(triangles) == 12
    assert np.isfinite(vertices).all()


def triangulation(obj):
    obj.data.calc_loop_triangles()
    return obj.data.loop_triangles


def test_an_empty_scene_has_no_occluders(scene):
    vertices, triangles, _ = occluders()
    assert vertices.shape == (0, 3)
    assert triangles.shape == (0, 3)


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
        (not_finite, "has 2 vertices with NaN or infinite"),
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


def test_free_normals_at_vertices_are_those_that_shade(scene):
    obj = place(ball())
    up = np.tile(np.float32((0, 0, 1)), (len(obj.data.vertices), 1))
    obj.data.normals_split_custom_set_from_vertices(up)
    obj.data.update()
    bpy.context.view_layer.update()
    np.testing.assert_allclose(receiver_of(obj).normals[:, 2], 1, atol=1e-3)
