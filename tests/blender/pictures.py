"""Small renders, read back as arrays."""

from pathlib import Path

import bpy
import numpy as np
import OpenEXR

EEVEE = "BLENDER_EEVEE" if bpy.app.version >= (5, 0) else "BLENDER_EEVEE_NEXT"


def look_down(scene, width, height):
    """A camera that sees ``width`` x ``height`` metres, ten pixels a metre, from above."""
    camera = bpy.data.cameras.new("Camera")
    camera.type, camera.ortho_scale = "ORTHO", max(width, height)
    scene.camera = bpy.data.objects.new("Camera", camera)
    scene.camera.location = width / 2, height / 2, 10
    scene.collection.objects.link(scene.camera)
    scene.render.resolution_x, scene.render.resolution_y = round(10 * width), round(10 * height)
    scene.render.resolution_percentage = 100


def pixel_centres(scene):
    """World x and y (H, W, 2) of every pixel of ``look_down``'s picture, top row first."""
    width, height = scene.render.resolution_x, scene.render.resolution_y
    x, y = (np.arange(width) + 0.5) / 10, (height - np.arange(height) - 0.5) / 10
    return np.stack(np.meshgrid(x, y), axis=-1)


def show_exit(scene, material):
    """Show the Exit Radiance of the group in a pass of its own, kept in float; the group."""
    if "Exit" not in scene.view_layers[0].aovs:
        scene.view_layers[0].aovs.add().name = "Exit"
    tree = material.node_tree
    group = next(node for node in tree.nodes if node.type == "GROUP")
    output = tree.nodes.new("ShaderNodeOutputAOV")
    output.aov_name = "Exit"
    tree.links.new(group.outputs["Exit Radiance"], output.inputs["Color"])
    return group


def render(scene, folder: Path, engine=EEVEE, samples=1):
    """Channels of the picture by name, "Combined.R" ..., each (H, W) float32, top row first."""
    set_up(scene, engine, samples)
    scene.render.filepath = str(folder / "picture.exr")
    bpy.ops.render.render(write_still=True)
    return _channels(folder / "picture.exr")


def render_frames(scene, folder: Path, first, last):
    """The colour (F, H, W, 3) of an animation in EEVEE, as Blender renders one."""
    set_up(scene)
    scene.frame_start, scene.frame_end = first, last
    scene.render.filepath = str(folder / "frame_")
    bpy.ops.render.render(animation=True)
    paths = [folder / f"frame_{frame:04}.exr" for frame in range(first, last + 1)]
    return np.stack([colour(_channels(path), "Combined") for path in paths])


def set_up(scene, engine=EEVEE, samples=1):
    """Small, plain and repeatable."""
    scene.render.engine = engine
    scene.render.filter_size = 0.0
    scene.render.use_compositing = scene.render.use_sequencer = False
    scene.eevee.taa_render_samples = samples
    scene.cycles.samples, scene.cycles.use_denoising = samples, False
    scene.cycles.pixel_filter_type, scene.cycles.seed = "BOX", 0
    if scene.world is not None:
        scene.world.probe_resolution = "128"
    image = scene.render.image_settings
    if bpy.app.version >= (5, 0):
        image.media_type = "MULTI_LAYER_IMAGE"
    image.file_format, image.color_depth = "OPEN_EXR_MULTILAYER", "32"
    image.exr_codec = "NONE"


def colour(picture, name):
    """One pass (H, W, 3)."""
    return np.stack([picture[f"{name}.{c}"] for c in "RGB"], axis=-1)


def _channels(path):
    found = {}
    with OpenEXR.File(str(path), separate_channels=True) as exr:
        for part in exr.parts:
            for name, channel in part.channels.items():
                found[name.split(".", 1)[1]] = np.array(channel.pixels, np.float32)
    return found
