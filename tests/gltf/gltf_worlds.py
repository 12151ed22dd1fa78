"""Worlds to be lit by."""

from pathlib import Path

import bpy


def colour(scene, value):
    """The same light from everywhere; its Background node."""
    scene.world = bpy.data.worlds.new("World")
    if bpy.app.version < (5, 0):
        scene.world.use_nodes = True
    background = scene.world.node_tree.nodes["Background"]
    background.inputs["Color"].default_value = (*value, 1)
    return background


def bundled(name):
    """The file of one of Blender's HDRIs."""
    return Path(bpy.utils.system_resource("DATAFILES", path="studiolights/world"), f"{name}.exr")


def hdri(scene, name, turned=0.0):
    """One of Blender's HDRIs, turned about Z by radians."""
    background = colour(scene, (1, 1, 1))
    tree = scene.world.node_tree
    coordinates = tree.nodes.new("ShaderNodeTexCoord")
    mapping = tree.nodes.new("ShaderNodeMapping")
    texture = tree.nodes.new("ShaderNodeTexEnvironment")
    texture.image = bpy.data.images.load(str(bundled(name)))
    mapping.inputs["Rotation"].default_value = (0, 0, turned)
    tree.links.new(coordinates.outputs["Generated"], mapping.inputs["Vector"])
    tree.links.new(mapping.outputs["Vector"], texture.inputs["Vector"])
    tree.links.new(texture.outputs["Color"], background.inputs["Color"])
