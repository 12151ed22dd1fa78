"""Objects to bake and to export."""

import bpy
import numpy as np
from glb import Glb
from mathutils import Euler, Matrix
from prt_baker.addon import gltf_export


def monkey(name="Monkey", location=(0, 0, 0)):
    bpy.ops.mesh.primitive_monkey_add(location=location)
    obj = bpy.context.object
    obj.name = name
    return obj


def plain():
    return monkey()


def rotated():
    obj = monkey(location=(1, 2, 3))
    obj.rotation_euler = (0.4, 1.1, -2)
    return obj


def mirrored():
    obj = rotated()
    obj.scale = (-1, 2, 0.5)
    return obj


def sheared():
    """A turned child of a parent that is scaled unevenly."""
    parent = bpy.data.objects.new("Parent", None)
    bpy.context.collection.objects.link(parent)
    parent.scale, parent.rotation_euler = (1, 3, 0.5), (0.2, 0.3, 0.4)
    obj = mirrored()
    obj.parent = parent
    return obj


def sheared_by_itself():
    """Parented with its place kept: its own matrix is sheared, which no glTF node can hold."""
    obj = sheared()
    obj.matrix_parent_inverse = (
        Matrix.Diagonal((1, 4, 1, 1)) @ Euler((1, 1, 0)).to_matrix().to_4x4()
    )
    return obj


NODES = [plain, rotated, mirrored, sheared, sheared_by_itself]


def paint(mesh, name, kind, domain):
    attribute = mesh.color_attributes.new(name, kind, domain)
    values = np.random.default_rng(len(name)).uniform(size=(len(attribute.data), 4))
    attribute.data.foreach_set("color", values.astype(np.float32).ravel())


def colored(colors, reading=None):
    """One object with colour attributes and two materials; the first reads ``reading``."""
    obj = monkey()
    for color in colors:
        paint(obj.data, *color)
    for name in ("One", "Two") if reading != "no material" else ():
        material = bpy.data.materials.new(name)
        if bpy.app.version < (5, 0):
            material.use_nodes = True
        obj.data.materials.append(material)
    if reading in (*[color[0] for color in colors], ""):
        nodes = obj.data.materials["One"].node_tree.nodes
        node = nodes.new("ShaderNodeVertexColor")
        node.layer_name = reading
        principled = next(n for n in nodes if n.type == "BSDF_PRINCIPLED")
        obj.data.materials["One"].node_tree.links.new(
            node.outputs["Color"], principled.inputs["Base Color"]
        )
    for polygon in list(obj.data.polygons)[::2]:
        polygon.material_index = 1
    obj["artist"] = 1
    return obj


def export(path, **options):
    """File > Export, as an artist may set it."""
    with gltf_export._found_by_the_exporter():
        bpy.ops.export_scene.gltf(filepath=str(path), export_format="GLB", **options)
    return Glb(path)


COLORS = [("Paint", "BYTE_COLOR", "CORNER"), ("Dirt", "FLOAT_COLOR", "POINT")]


def sharing(bake):
    """Two objects of one mesh, each with a bake of its own."""
    first = monkey("First")
    second = first.copy()
    second.name, second.location = "Second", (3, 0, 0)
    bpy.context.scene.collection.objects.link(second)
    for obj in (first, second):
        bake(obj, by_modifier=True, turns=1)


def modified(bake):
    obj = monkey()
    obj.modifiers.new("Subdivision", "SUBSURF")
    bake(obj, by_modifier=True, turns=1)


def several_scenes(bake):
    """The light of each lies in its extras."""
    bake(monkey("Here"), turns=1)
    other = bpy.data.scenes.new("Other scene")
    there = monkey("There")
    bpy.context.scene.collection.objects.unlink(there)
    other.collection.objects.link(there)


# What a file may hold: name, function that makes and bakes it
BAKED = {
    "plain": lambda bake: bake(plain()),
    "rotated, residual": lambda bake: bake(rotated(), turns=1),
    "mirrored, corners": lambda bake: bake(mirrored(), turns=1, domain="CORNER"),
    "sheared": lambda bake: bake(sheared(), turns=1),
    "sheared by itself": lambda bake: bake(sheared_by_itself(), turns=1),
    "shared mesh": sharing,
    "modifier": modified,
    "several scenes": several_scenes,
    "order 2, three channels": lambda bake: bake(plain(), order=2, channels=3, turns=1),
    "order 4, three channels": lambda bake: bake(plain(), order=4, channels=3, turns=1),
    "order 5, peaks": lambda bake: bake(plain(), order=5, turns=1, lights=2),
    "what is seen": lambda bake: bake(rotated(), turns=1, seen=3),
    "direct light apart": lambda bake: bake(rotated(), channels=3, turns=1, lights=2, direct=True),
    "order 3, twelve turns": lambda bake: bake(plain(), turns=12),
    "colours, two materials": lambda bake: bake(colored(COLORS, "Dirt"), turns=1),
}
