"""Meshes and objects to be read as arrays."""

import bmesh
import bpy
import numpy as np
from mathutils import Matrix
from prt_baker.addon import scene as scene_arrays

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
        bpy.context.scene.collection.objects.link(obj.parent)
    (collection or bpy.context.scene.collection).objects.link(obj)
    bpy.context.view_layer.update()
    return obj


def receiver_of(obj):
    return scene_arrays.read_receivers(bpy.context.evaluated_depsgraph_get(), [obj])[0]


def geometric_normals(vertices, triangles):
    a, b, c = (vertices[triangles[:, i]] for i in range(3))
    return np.cross(b - a, c - a)


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
