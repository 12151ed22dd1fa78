"""The world's light for viewers that know nothing of bakes: EXT_lights_image_based.

Its cube map stands in axes of its own, left-handed as OpenGL's: +x of the cube is -x of the file.
That is how Babylon.js, which the extension comes from, reads it; the specification does not say.
"""

from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import Any

import bpy
import numpy as np
import numpy.typing as npt
from io_scene_gltf2.io.com import gltf2_io, gltf2_io_extensions

from . import cache_folder, carrier, engine, world
from .gltf_frame import Float
from .prt import sh
from .prt.errors import BakeError
from .prt.files import rgbd
from .prt.files.png import png_bytes
from .prt.job import Job, LightSource, Settings
from .prt.light.projection import world_sh
from .prt.specular import cube
from .prt.specular.sheet import Sheet
from .prt.steps import value_of

NAME = "EXT_lights_image_based"
CUBE = np.diag([-1.0, 1.0, 1.0])  # takes directions of the file to those of the cube
SIGNS = np.array([1, -1, 1, -1, 1, -1, 1, -1, 1])  # the extension has the Condon-Shortley phase
# Means of the radiance that pictures hold as they are.  Others are scaled by the light's intensity,
# which Babylon.js takes twice for its irradiance; so most worlds do without.
HELD = 1 / 64, 16.0


@dataclass(frozen=True)
class _World:
    """A world called ``name``, and of its picture alone the coefficients ``image_sh`` (25, 3) and
    the filtered radiance, ``pixels`` (H, W, 4) arranged as ``sheet``."""

    name: str
    source: LightSource
    image_sh: Float
    sheet: Sheet
    pixels: npt.NDArray[np.float32]


class Lights:
    """The light of every scene, made before anything is written, as a world may have to be
    rendered; ``problems`` are sentences by the name of the scene."""

    def __init__(self) -> None:
        self.problems: dict[str, str] = {}
        self._worlds: dict[str, _World] = {}
        for scene in bpy.data.scenes:
            try:
                self._worlds[scene.name] = _read(scene)
            except BakeError as error:
                self.problems[scene.name] = str(error)

    def dress(self, scene: Any, name: str, frame: Float) -> None:
        """Give the exporter's ``scene`` the light of Blender's scene ``name``, if it has one."""
        if name not in self._worlds:
            return
        light = gltf2_io_extensions.ChildOfRootExtension(
            name=NAME,
            path=["lights"],
            required=False,
            extension=_described(self._worlds[name], frame),
        )
        scene.extensions = scene.extensions or {}
        scene.extensions[NAME] = gltf2_io_extensions.Extension(
            name=NAME, extension={"light": light}, required=False
        )


def _read(scene: bpy.types.Scene) -> _World:
    with engine.job_folder() as work, engine.job_folder() as folder:
        source = world.read(scene, carrier.depsgraph_of(scene), folder).source
        settings = Settings(reflections=True, cache=cache_folder.path())
        results = value_of(engine.run(Job("light", settings, source), work))
        found = results.reflections
        assert found is not None
        return _World(scene.world.name, source, results.image_sh, found.sheet, _pixels(found.path))


def _pixels(path: Path) -> npt.NDArray[np.float32]:
    """The numbers of an .exr, row 0 at the bottom."""
    image = bpy.data.images.load(str(path), check_existing=False)
    try:
        image.colorspace_settings.name, image.alpha_mode = "Non-Color", "CHANNEL_PACKED"
        width, height = image.size
        values = np.empty(4 * width * height, np.float32)
        image.pixels.foreach_get(values)
    finally:
        bpy.data.images.remove(image)
    return values.reshape(height, width, 4)


def _described(shown: _World, frame: Float) -> dict[str, Any]:
    """A light of the extension in the axes of ``frame``."""
    source, to_cube = shown.source, CUBE @ frame
    mips = cube.mips(shown.sheet, shown.pixels, source.rotation @ to_cube.T)
    radiance = world_sh(shown.image_sh, source.strength, source.rotation)
    mean = float(radiance[0].max() * sh.basis([0.0, 0.0, 1.0], 1)[0])
    intensity = 1.0 if mean <= 0 or HELD[0] <= mean <= HELD[1] else mean
    factor = np.array(source.strength) / intensity
    return {
        "name": shown.name,
        "intensity": intensity,
        "irradianceCoefficients": (_irradiance(radiance, to_cube) / intensity).tolist(),
        "specularImageSize": mips[0].shape[1],
        "specularImages": [
            [_image(face * factor, f"{shown.name} {k}.{i}") for i, face in enumerate(mip)]
            for k, mip in enumerate(mips)
        ],
    }


def _irradiance(radiance_sh: Float, to_cube: Float) -> Float:
    """The coefficients (9, 3) of irradiance that belong to ``radiance_sh`` (25, 3), as the
    extension has them."""
    turned = sh.rotate(radiance_sh, to_cube)[: len(SIGNS)]
    factors = SIGNS * sh.clamped_cosine(3)[sh.bands(3)]
    return np.asarray(factors[:, None] * turned)


def _binary(data: bytes) -> Any:
    """``data`` for a buffer; the exporter's class has moved."""
    for module in ("binary_data", "gltf2_io_binary_data"):
        try:
            found = import_module(f"io_scene_gltf2.io.exp.{module}")
        except ModuleNotFoundError:
            continue
        return found.BinaryData(data)
    raise AssertionError("Blender's exporter has no binary data")


def _image(radiance: npt.NDArray[np.floating], name: str) -> gltf2_io.Image:
    return gltf2_io.Image(
        buffer_view=_binary(png_bytes(rgbd.encoded(radiance))),
        extensions=None,
        extras=None,
        mime_type="image/png",
        name=name,
        uri=None,
    )
