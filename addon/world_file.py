"""A world made from an HDRI on disk, for bakes that name one."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import bpy


@contextmanager
def made(path: str) -> Iterator[bpy.types.World]:
    """A new world, not yet in use, that shows the lat-long image at ``path``; gone with its image
    on an error inside."""
    before = set(bpy.data.images) | set(bpy.data.worlds)
    try:
        yield _world(path)
    except BaseException:
        bpy.data.batch_remove((set(bpy.data.images) | set(bpy.data.worlds)) - before)
        raise


def _world(path: str) -> bpy.types.World:
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
    return world
