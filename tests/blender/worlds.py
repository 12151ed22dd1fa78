"""Worlds to be lit by."""

import bpy
import numpy as np
from prt_baker.addon.prt.files import images


def new_world(scene):
    """A world with a Background; its node tree."""
    scene.world = bpy.data.worlds.new("World")
    if bpy.app.version < (5, 0):
        scene.world.use_nodes = True
    return scene.world.node_tree


def picture(seed=0):
    """A lat-long picture (32, 64, 3) without symmetry: broad lobes, and a sun."""
    y, x = np.mgrid[0:32, 0:64] / 32
    lobes = 1 + 0.8 * np.cos(np.pi * x)[..., None] * np.sin(np.pi * y)[..., None] * (1, 0.5, 0.2)
    lobes = lobes + seed * np.array((0.3, 0.1, 0))
    lobes[5:8, 9:13] += 20
    return lobes.astype(np.float32)


def generated(pixels, name="Picture"):
    """An image in memory that shows ``pixels``, top row first."""
    height, width, _ = pixels.shape
    image = bpy.data.images.new(name, width, height, float_buffer=True)
    alpha = np.ones((height, width, 1), np.float32)
    image.pixels.foreach_set(np.concatenate([pixels[::-1], alpha], axis=-1).ravel())
    return image


def loaded(pixels, path):
    """An image from a file that shows ``pixels``."""
    images.write_exr(str(path), pixels)
    return bpy.data.images.load(str(path))


def environment(scene, image, strength=1.5, rotation=(0.4, -0.7, 1.1), kind="POINT"):
    """Texture Coordinate, Mapping, Environment Texture, Background: nodes by name."""
    tree = new_world(scene)
    nodes = {
        name: tree.nodes.new(kind)
        for name, kind in (
            ("coordinates", "ShaderNodeTexCoord"),
            ("mapping", "ShaderNodeMapping"),
            ("texture", "ShaderNodeTexEnvironment"),
        )
    }
    nodes["background"] = background = tree.nodes["Background"]
    nodes["texture"].image = image
    nodes["mapping"].vector_type = kind
    nodes["mapping"].inputs["Rotation"].default_value = rotation
    background.inputs["Strength"].default_value = strength
    tree.links.new(nodes["coordinates"].outputs["Generated"], nodes["mapping"].inputs["Vector"])
    tree.links.new(nodes["mapping"].outputs["Vector"], nodes["texture"].inputs["Vector"])
    tree.links.new(nodes["texture"].outputs["Color"], background.inputs["Color"])
    return nodes
