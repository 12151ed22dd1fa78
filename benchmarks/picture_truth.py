"""What Cycles shows, twice with other random numbers, kept in a cache because it is slow.

Both engines look through the middles of the pixels alone, so that no silhouette is blurred and the
pictures differ by their light.  ``relative_error`` multiplies the differences to Cycles' two
pictures, whose noises know nothing of each other: what is left of them is the error alone.
"""

import hashlib
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory

import bpy
import numpy as np
import numpy.typing as npt
import OpenEXR

Picture = npt.NDArray[np.float32]
Mask = npt.NDArray[np.bool_]
EEVEE = "BLENDER_EEVEE" if bpy.app.version >= (5, 0) else "BLENDER_EEVEE_NEXT"
VERSION = 1
SAMPLES = 128  # of each of the two


@dataclass(frozen=True)
class Truth:
    """Two pictures (H, W, 3) of the same light with other noise."""

    first: Picture
    second: Picture

    def noise(self, covered: Mask) -> float:
        """Relative RMS of the noise of their mean."""
        difference, mean = (self.first - self.second) / 2, (self.first + self.second) / 2
        return float(np.sqrt((difference[covered] ** 2).sum() / (mean[covered] ** 2).sum()))


def relative_error(picture: Picture, truth: Truth, covered: Mask) -> float:
    """RMS of the difference to ``truth``, without its noise, over the RMS of ``truth``."""
    seen, first, second = (p[covered].astype(float) for p in (picture, truth.first, truth.second))
    error = ((seen - first) * (seen - second)).sum() / (first * second).sum()
    return float(np.sqrt(max(error, 0.0)))


def truth(cache: Path, bounces: int = 0) -> Truth:
    """Cycles' pictures of the scene that is open, under its world as it is, with diffuse light that
    bounces so many times."""
    path = cache / f"{_key()}{f'-{bounces}' if bounces else ''}.npz"
    if not path.exists():
        cache.mkdir(parents=True, exist_ok=True)
        with TemporaryDirectory() as folder:
            pictures = [colour(cycles(Path(folder), SAMPLES, seed, bounces)) for seed in (1, 2)]
        np.savez(path, first=pictures[0], second=pictures[1])
    with np.load(path) as kept:
        return Truth(kept["first"], kept["second"])


def objects(folder: Path) -> npt.NDArray[np.int64]:
    """The number (H, W) of the object that a pixel shows, its place among the meshes from 1 on.

    0 where there is none, or where the two engines see places further apart than a pixel: at a
    silhouette that goes through the middle of the pixel.
    """
    layer = bpy.context.view_layer
    layer.use_pass_position = layer.use_pass_object_index = True
    seen = cycles(folder, 1, 1)
    shown = eevee(folder)
    layer.use_pass_position = layer.use_pass_object_index = False
    places = [np.stack([p[f"Position.{c}"] for c in "XYZ"], axis=-1) for p in (seen, shown)]
    agree = np.linalg.norm(places[0] - places[1], axis=-1) < _pixel_size(places[0])
    return np.where(agree, np.rint(seen["Object Index.X"]), 0).astype(int)


def eevee(folder: Path, samples: int = 1) -> dict[str, Picture]:
    """What EEVEE shows, by channel."""
    scene = bpy.context.scene
    scene.render.engine = EEVEE
    scene.render.filter_size = 0.0
    scene.eevee.taa_render_samples = samples
    return channels(folder)


def channels(folder: Path) -> dict[str, Picture]:
    """Render the scene as it is set up: each channel (H, W) by name, "Combined.R" ..."""
    path = folder / "render.exr"
    render = bpy.context.scene.render
    image = render.image_settings
    if bpy.app.version >= (5, 0):
        image.media_type = "MULTI_LAYER_IMAGE"
    image.file_format, image.color_depth, image.exr_codec = "OPEN_EXR_MULTILAYER", "32", "NONE"
    render.use_compositing = render.use_sequencer = False
    render.filepath = str(path)
    bpy.ops.render.render(write_still=True)
    found = {}
    with OpenEXR.File(str(path), separate_channels=True) as exr:
        for part in exr.parts:
            for name, channel in part.channels.items():
                found[name.split(".", 1)[1]] = np.array(channel.pixels, np.float32)
    path.unlink()
    return found


def colour(picture: dict[str, Picture]) -> Picture:
    """The colour (H, W, 3) of what ``channels`` returns."""
    return np.stack([picture[f"Combined.{c}"] for c in "RGB"], axis=-1)


def cycles(folder: Path, samples: int, seed: int, bounces: int = 0) -> dict[str, Picture]:
    """Diffuse light of the whole HDRI."""
    scene, cycles = bpy.context.scene, bpy.context.scene.cycles
    scene.render.engine = "CYCLES"
    cycles.samples, cycles.seed = samples, seed
    cycles.max_bounces = cycles.diffuse_bounces = bounces
    cycles.light_sampling_threshold = 0
    cycles.sample_clamp_direct = cycles.sample_clamp_indirect = 0
    cycles.use_denoising = cycles.use_adaptive_sampling = False
    cycles.pixel_filter_type, cycles.filter_width = "GAUSSIAN", 0.01
    return channels(folder)


def _pixel_size(places: Picture) -> Picture:
    """How wide a pixel is (H, W) at ``places`` (H, W, 3)."""
    scene = bpy.context.scene
    camera = scene.camera
    distance = np.linalg.norm(places - np.array(camera.matrix_world.translation), axis=-1)
    return distance * camera.data.sensor_width / camera.data.lens / scene.render.resolution_x


def _key() -> str:
    """Names all that decides what Cycles shows."""
    scene = bpy.context.scene
    render, camera = scene.render, scene.camera
    nodes = scene.world.node_tree.nodes
    turn = tuple(next(n for n in nodes if n.type == "MAPPING").inputs["Rotation"].default_value)
    hdri = bpy.path.abspath(next(n for n in nodes if n.type == "TEX_ENVIRONMENT").image.filepath)
    size = (render.resolution_x, render.resolution_y)
    view = (tuple(map(tuple, camera.matrix_world)), camera.data.lens)
    header = (VERSION, bpy.app.version, SAMPLES, size, view, turn)
    digest = hashlib.blake2b(repr(header).encode(), digest_size=12)
    digest.update(Path(hdri).read_bytes())
    depsgraph = bpy.context.evaluated_depsgraph_get()
    for obj in (o for o in scene.objects if o.type == "MESH"):
        mesh = obj.evaluated_get(depsgraph).data
        places = np.empty(3 * len(mesh.vertices), np.float32)
        mesh.vertices.foreach_get("co", places)
        digest.update(repr((obj.name, tuple(map(tuple, obj.matrix_world)))).encode())
        digest.update(places)
    return digest.hexdigest()
