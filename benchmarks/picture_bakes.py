"""The scene of a picture as our bakes show it in EEVEE, and as EEVEE's own volume probe does."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import bpy
import picture_scenes
import picture_truth
import prt_baker
from picture_truth import Picture
from prt_baker.addon import bake, remove
from prt_baker.addon.atlas_files import Target
from prt_baker.addon.prt.job import Settings
from prt_baker.addon.prt.steps import value_of

PROBE_CELLS = (16, 16, 8)
PROBE_RAYS = 256
SURFELS = 8  # a metre
PROBE_SAMPLES = 4  # of the picture


@contextmanager
def add_on() -> Iterator[None]:
    """Our add-on is registered, so that the light of the bakes follows the world."""
    prt_baker.register()
    try:
        yield
    finally:
        prt_baker.unregister()  # what is registered at exit makes some bpy wheels hang


def bake_all(settings: Settings, carrier: str = "vertex") -> dict:
    """Bake every mesh under the world as it is; the report."""
    names = [obj.name for obj in picture_scenes.meshes()]
    steps = bake.bake(bpy.context.scene.name, names, settings, target=Target(carrier))
    return value_of(steps)


def remove_all() -> None:
    """Take every bake away: the artist's materials are lit by EEVEE again."""
    remove.remove(bpy.context.scene, picture_scenes.meshes())


def picture(folder: Path) -> Picture:
    """What EEVEE shows of the bake: one look through the middle of every pixel."""
    return picture_truth.colour(picture_truth.eevee(folder))


@contextmanager
def volume_probe() -> Iterator[None]:
    """A Light Probe Volume around everything that shows the world alone, as the artist's material
    is lit in EEVEE without us."""
    data = bpy.data.lightprobes.new("Probe", "VOLUME")
    data.resolution_x, data.resolution_y, data.resolution_z = PROBE_CELLS
    data.capture_world, data.capture_indirect, data.capture_emission = True, False, False
    data.bake_samples, data.surfel_density = PROBE_RAYS, SURFELS
    probe = bpy.data.objects.new("Probe", data)
    probe.location, probe.scale = (0, 0, 1), (4, 4, 2.2)
    bpy.context.collection.objects.link(probe)
    try:
        yield
    finally:
        bpy.data.objects.remove(probe)


def probe_picture(folder: Path) -> Picture:
    """What EEVEE shows inside of a volume probe, baked for the world as it is."""
    bpy.context.scene.render.engine = picture_truth.EEVEE
    bpy.ops.object.lightprobe_cache_bake(subset="ALL")
    return picture_truth.colour(picture_truth.eevee(folder, PROBE_SAMPLES))
