"""A world that no reading of its nodes can tell, rendered by Cycles to a lat-long picture.

In a scene of its own, which is gone afterwards.
"""

import os
from collections.abc import Iterator
from contextlib import contextmanager
from errno import ENOSPC
from math import pi
from pathlib import Path

import bpy
import numpy as np

from . import engine, world_images
from .prt.errors import BakeError
from .prt.job import Array, LightSource

WIDTH, HEIGHT = 512, 256
SAMPLES = 8
PEAK_SAMPLES = 4096  # a sun fills half a pixel: 16 samples a pixel miss its light by 20 %
PEAK_REACH = 3  # pixels to each side of the brightest
NAME = "PRT World"
DIFFUSE = {"Is Diffuse Ray", "Is Reflection Ray", "Ray Depth", "Diffuse Depth"}


def render(scene: bpy.types.Scene, width: int = WIDTH, height: int = HEIGHT) -> Array:
    """Radiance (height, width, 3) float32 of ``scene``'s world as a diffuse ray meets it, top row
    first, at the scene's frame; BakeError where an image of it can't be loaded."""
    _check_images(scene.world.node_tree)
    with _studio(scene) as studio:
        studio.render.resolution_x, studio.render.resolution_y = width, height
        pixels = _picture(studio, SAMPLES)
        around = _aim_at_peak(studio, pixels)
        pixels[around] = _picture(studio, PEAK_SAMPLES)[around]
    return pixels


def _aim_at_peak(studio: bpy.types.Scene, pixels: Array) -> tuple[slice, slice]:
    """Let ``studio`` render only the neighbourhood of the brightest pixel: its rows and columns."""
    height, width = pixels.shape[:2]
    row, column = np.unravel_index(pixels.sum(axis=-1).argmax(), (height, width))
    top, bottom = max(0, row - PEAK_REACH), min(height, row + PEAK_REACH + 1)
    left, right = max(0, column - PEAK_REACH), min(width, column + PEAK_REACH + 1)
    settings = studio.render
    settings.use_border = True
    settings.border_min_x, settings.border_max_x = left / width, right / width
    settings.border_min_y, settings.border_max_y = 1 - bottom / height, 1 - top / height
    return slice(top, bottom), slice(left, right)


def _picture(studio: bpy.types.Scene, samples: int) -> Array:
    """What ``studio`` renders, (H, W, 3) float32, top row first."""
    studio.cycles.samples = samples
    with engine.job_folder() as folder:
        path = folder / "world.exr"
        studio.render.filepath = str(path)
        bpy.ops.render.render(write_still=True, scene=studio.name)
        _check_whole(path, studio.render.resolution_x, studio.render.resolution_y)
        return _load(path)


def _check_whole(path: Path, width: int, height: int) -> None:
    """OSError when Blender could not write all of its picture, which it does not tell."""
    if not path.is_file() or path.stat().st_size < height * (12 * width + 16):
        raise OSError(ENOSPC, os.strerror(ENOSPC))


@contextmanager
def _studio(scene: bpy.types.Scene) -> Iterator[bpy.types.Scene]:
    """A scene with nothing but a copy of the world and a camera that sees all of it."""
    before = _everything()
    try:
        studio = bpy.data.scenes.new(NAME)
        studio.world = scene.world.copy()
        _as_diffuse_rays_see(studio.world.node_tree)
        _keep_one_output(studio.world.node_tree)
        studio.frame_current = scene.frame_current
        studio.frame_subframe = scene.frame_subframe
        _set_up_camera(studio)
        _set_up_render(studio)
        yield studio
    finally:
        bpy.data.batch_remove(_everything() - before)


def _everything() -> set[bpy.types.ID]:
    kinds = ("scenes", "worlds", "cameras", "objects", "images", "node_groups", "linestyles")
    return {block for kind in kinds for block in getattr(bpy.data, kind)}


def _set_up_camera(studio: bpy.types.Scene) -> None:
    """Panorama: u grows against the azimuth, and the middle column looks along +x."""
    data = bpy.data.cameras.new(NAME)
    data.type = "PANO"
    data.panorama_type = "EQUIRECTANGULAR"
    camera = bpy.data.objects.new(NAME, data)
    camera.rotation_euler = (pi / 2, 0, -pi / 2)
    studio.collection.objects.link(camera)
    studio.camera = camera


def _set_up_render(studio: bpy.types.Scene) -> None:
    try:
        studio.render.engine = "CYCLES"
    except TypeError as error:
        raise BakeError("This world has to be rendered: enable the add-on Cycles") from error
    studio.cycles.use_adaptive_sampling = False
    studio.cycles.use_denoising = False
    studio.cycles.pixel_filter_type = "BOX"
    studio.world.cycles.sampling_method = "NONE"
    studio.render.resolution_percentage = 100
    studio.render.use_compositing = studio.render.use_sequencer = False
    settings = studio.render.image_settings
    settings.file_format, settings.color_depth, settings.exr_codec = "OPEN_EXR", "32", "NONE"
    settings.color_mode = "RGB"


def _keep_one_output(tree: bpy.types.NodeTree) -> None:
    """Cycles renders the output that EEVEE uses, without its volume."""
    used = tree.get_output_node("EEVEE")
    for node in [node for node in tree.nodes if node.bl_idname == used.bl_idname]:
        if node != used:
            tree.nodes.remove(node)
    used.target = "ALL"
    for link in used.inputs["Volume"].links:
        tree.links.remove(link)


def _as_diffuse_rays_see(tree: bpy.types.NodeTree) -> None:
    """Answer each Light Path as for a diffuse ray: a world often shows the camera another picture
    than the one that lights.  Node groups are copied, so that the artist's stay as they are."""
    for node in list(tree.nodes):
        if node.bl_idname == "ShaderNodeLightPath":
            for output in node.outputs:
                _fix(tree, output, 1.0 if output.name in DIFFUSE else 0.0)
        elif getattr(node, "node_tree", None):
            node.node_tree = node.node_tree.copy()
            _as_diffuse_rays_see(node.node_tree)


def _fix(tree: bpy.types.NodeTree, output: bpy.types.NodeSocket, value: float) -> None:
    """Replace what ``output`` feeds by a constant."""
    constant = tree.nodes.new("ShaderNodeValue")
    constant.outputs[0].default_value = value
    for target in [link.to_socket for link in output.links]:
        tree.links.new(constant.outputs[0], target)


def _check_images(tree: bpy.types.NodeTree) -> None:
    """BakeError for an image that Cycles would show as magenta."""
    for node in tree.nodes:
        if getattr(node, "node_tree", None):
            _check_images(node.node_tree)
        elif hasattr(node, "image") and any(output.is_linked for output in node.outputs):
            _check_image(node)


def _check_image(node: bpy.types.Node) -> None:
    image = node.image
    if image is None:
        raise BakeError(f"Node {node.name!r} of the world has no image: open one or unlink it")
    if image.source != "FILE":
        return
    path = world_images.path(image)
    if not image.packed_file and not path.is_file():
        raise world_images.missing(image)
    if world_images.is_decoded(image):
        _decode(image)
    elif not image.size[0]:
        name = image.name if image.packed_file else str(path)
        raise BakeError(f"The world's image {name!r} can't be read: open another one")


def _decode(image: bpy.types.Image) -> None:
    """BakeError when the engine can't read the file of ``image``: Blender's reader may crash."""
    with engine.job_folder() as folder, engine.job_folder() as work:
        if image.packed_file:
            path, title = world_images.unpacked(image, folder), image.name
        else:
            path, title = world_images.path(image), ""
        engine.run_light(LightSource(image=str(path), title=title), work)


def _load(path: Path) -> Array:
    """Our own file back through Blender: the pixels of a render result can't be read."""
    image = bpy.data.images.load(str(path))
    image.colorspace_settings.name = "Non-Color"
    values = np.empty(image.size[0] * image.size[1] * image.channels, np.float32)
    image.pixels.foreach_get(values)
    rows = values.reshape(image.size[1], image.size[0], -1)[::-1, :, :3]
    return np.ascontiguousarray(rows)
