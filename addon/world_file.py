"""A world made from an HDRI on disk, for bakes that name one."""

from pathlib import Path

import bpy


def assign(scene: bpy.types.Scene, path: str) -> None:
    """Give ``scene`` a new world that shows the lat-long image at ``path``."""
    world = bpy.data.worlds.new(Path(path).stem)
    if world.node_tree is None:
        world.use_nodes = True
    tree = world.node_tree
    tree.nodes.clear()
    output = tree.nodes.new("ShaderNodeOutputWorld")
    background = tree.nodes.new("ShaderNodeBackground")
    texture = tree.nodes.new("ShaderNodeTexEnvironment")
    texture.image = bpy.data.images.load(path, check_existing=True)
    texture.location, background.location, output.location = (-400, 0), (-100, 0), (100, 0)
    tree.links.new(texture.outputs["Color"], background.inputs["Color"])
    tree.links.new(background.outputs["Background"], output.inputs["Surface"])
    scene.world = world
