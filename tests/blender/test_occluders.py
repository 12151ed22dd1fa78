"""Occluders are everything with faces that viewport and render both show, once and whole."""

from collections import Counter

import bmesh
import bpy
import numpy as np
import pytest
from mathutils import Matrix
from meshes import (
    MIRRORED,
    add_instance,
    ball,
    cube,
    geometric_normals,
    instance_of,
    mesh_of,
    place,
    scattered,
)
from prt_baker.addon import scene_occluders
from prt_baker.addon.scene_visibility import Rendered


def occluders():
    found = scene_occluders.read(bpy.context.evaluated_depsgraph_get())
    return found.vertices, found.triangles, found.repairs


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
    once = scene_occluders._read_mesh
    monkeypatch.setattr(scene_occluders, "_read_mesh", lambda o, a: read.append(o) or once(o, a))
    _, triangles, _ = occluders()
    assert len(read) == 1
    assert len(triangles) == 20 * len(mesh.polygons)


def test_every_object_and_instance_is_a_part_of_its_own(scene):
    mesh = cube()
    place(mesh)
    place(bpy.data.meshes.new("Empty"))
    place(ball(), matrix=MIRRORED)
    collection = bpy.data.collections.new("Inner")
    place(mesh, collection=collection)
    for x in (5, 10):
        instance_of(collection, matrix=Matrix.Translation((x, 0, 0)))
    found = scene_occluders.read(bpy.context.evaluated_depsgraph_get())
    assert found.starts[-1] == len(found.triangles)
    parts = [found.triangles[a:b] for a, b in zip(found.starts, found.starts[1:], strict=False)]
    assert sorted(map(len, parts))[:3] == [12, 12, 12]
    assert len(parts) == 4
    assert len(set.union(*(set(part.flat) for part in parts))) == sum(
        len(set(part.flat)) for part in parts
    )


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
    assert scene_occluders.read(bpy.context.evaluated_depsgraph_get()).starts.tolist() == [0]
