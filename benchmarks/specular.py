"""Reflections in EEVEE against what is documented, against what they stand for, against Cycles.

Spheres of five roughnesses under three of Blender's HDRIs.  Prints a table in Markdown: relative
RMS over a sphere's pixels and channels, the mean of the HDRIs.  ``--image`` writes the strip of
pictures of the documentation.
"""

import argparse
import os
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path

import bpy
import numpy as np
import picture_bakes
import picture_files
import picture_scenes
import picture_truth
import specular_scene
import specular_sums
from picture_scenes import demo_scene
from picture_truth import Picture, Truth
from prt_baker.addon import light_state, nodes, reflections
from prt_baker.addon.prt.files import images
from prt_baker.addon.prt.job import Settings
from prt_baker.addon.prt.light.projection import repair
from prt_baker.addon.prt.specular import prefilter, sheet
from specular_scene import Sphere

CACHE = picture_scenes.ROOT / ".cache" / "bench" / "pictures"
HDRIS = ("courtyard", "studio", "sunset")
TURN = 40.0  # of the world, in degrees
PIXELS = 48  # a sphere
STEP = 3  # of the pixels that are compared, a divisor of the above
TEXELS = (256, 512)  # rows and columns that are summed: the sharpest lobe is seven of them wide
STRIP, SAMPLES = 128, 16  # a sphere's pixels and the samples of what people look at
GREY = 0.18  # behind the strip's spheres
SETTINGS = Settings(reflections=True, rays=64, map_rays=16, fit=False)  # exact where all is open
SWITCHES = ("Energy Compensation", "Rough Look-up")
COLUMNS = (
    "EEVEE - formula",
    "formula - sum over texels",
    "EEVEE - Cycles",
    "worst HDRI",
    "sum over texels - Cycles",
    "switches off - Cycles",
)


def main() -> None:
    """The table, and the strip."""
    asked = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    asked.add_argument("--hdri", nargs="+", default=HDRIS)
    asked.add_argument("--image", type=Path, help="the strip: EEVEE's rows, then Cycles'")
    chosen = asked.parse_args()
    with tempfile.TemporaryDirectory() as temporary, picture_bakes.add_on():
        folder = Path(temporary)
        if chosen.image:
            strip(chosen.image, chosen.hdri[0], folder)
        else:
            print(table([measured(hdri, folder) for hdri in chosen.hdri]))
    sys.stdout.flush()
    os._exit(0)  # Blender may crash in its own clean-up at exit


def table(found: list[dict[Sphere, list[float]]]) -> str:
    """In Markdown, of the figures of each HDRI."""
    lines = ["| surface | roughness | " + " | ".join(f"{name}, %" for name in COLUMNS) + " |"]
    lines.append("|---" * (2 + len(COLUMNS)) + "|")
    for sphere in found[0]:
        figures = 100 * np.array([one[sphere] for one in found])
        mean, worst = figures.mean(axis=0), figures.max(axis=0)
        cells = [f"{mean[0]:.2f}", *(f"{f:.1f}" for f in (mean[1], mean[2], worst[2], *mean[3:]))]
        kind = "paint" if not sphere.surface.metallic else "gold"
        kind = "white, Glossy GGX" if sphere.is_glossy else f"{kind}, Principled"
        lines.append(f"| {kind} | {sphere.surface.roughness} | {' | '.join(cells)} |")
    return "\n".join(lines)


def measured(hdri: str, folder: Path) -> dict[Sphere, list[float]]:
    """The errors of each sphere under ``hdri``."""
    spheres = specular_scene.spheres(with_glossy=True)
    specular_scene.build(spheres, hdri, TURN, PIXELS)
    truth = picture_truth.truth(CACHE)
    picture_bakes.bake_all(SETTINGS)
    switch_off(spheres)
    shown = picture_bakes.picture(folder)
    under = Light(hdri)
    return {sphere: list(errors(sphere, under, shown, truth)) for sphere in spheres}


def errors(sphere: Sphere, light: "Light", shown: Picture, truth: Truth) -> Iterator[float]:
    """What ``COLUMNS`` say, but for the worst."""
    row, column, normals = specular_scene.seen(sphere, STEP)
    split, sums = light.about(sphere, normals)
    switches = not sphere.is_glossy

    def formula(*, switches: bool) -> Picture:
        return light.formula(sphere, normals, split, sums.white, switches=switches)

    def to_cycles(found: Picture) -> float:
        cut = Truth(truth.first[row, column], truth.second[row, column])
        return picture_truth.relative_error(found, cut, np.ones(len(row), bool))

    eevee = shown[row, column]
    whole = sums.exit_radiance(sphere.surface, split, compensated=switches)
    ours = formula(switches=switches)
    yield relative(eevee, ours)
    yield relative(ours, whole)
    yield to_cycles(eevee)
    yield to_cycles(whole)
    yield to_cycles(formula(switches=False))


def relative(found: Picture, expected: Picture) -> float:
    """RMS of the difference over the RMS of what is ``expected``."""
    return float(np.sqrt(np.square(found - expected).mean() / np.square(expected).mean()))


class Light:
    """The world of the open scene, which is baked: as EEVEE's image has it, and as it is."""

    def __init__(self, hdri: str) -> None:
        state = light_state.read(bpy.context.scene)
        assert state is not None
        self._turn, self._strength = np.array(state.rotation), np.array(state.strength)
        image = reflections.current()
        assert image is not None
        width, height = image.size
        values = np.empty(width * height * 4, np.float32)
        image.pixels.foreach_get(values)
        self._image, self._sheet = values.reshape(height, width, 4), reflections.of(image).sheet
        pixels, _ = repair(images.read(str(demo_scene.bundled_hdri(hdri))))
        self._sky = specular_sums.Sky(prefilter.resampled(pixels, *TEXELS))
        self._sums: dict[float, specular_sums.Sums] = {}

    def about(self, sphere: Sphere, normals: Picture) -> tuple[Picture, specular_sums.Sums]:
        """A and B (P, 2), and what the surface reflects of all texels."""
        n_v = normals @ specular_scene.VIEW
        roughness = sphere.surface.roughness
        split = sheet.split_sum(self._image, np.full(len(n_v), roughness), n_v)
        turned = normals @ self._turn.T, self._turn @ specular_scene.VIEW
        if roughness not in self._sums:  # the spheres of a column are seen in the same places
            self._sums[roughness] = self._sky.sums(*turned, roughness)
        return split, self._sums[roughness]

    def formula(
        self, sphere: Sphere, normals: Picture, split: Picture, white: Picture, *, switches: bool
    ) -> Picture:
        """What is documented (P, 3)."""
        turned = normals @ self._turn.T, self._turn @ specular_scene.VIEW
        light = self._image, self._sheet
        surface = sphere.surface
        return specular_sums.formula(*light, surface, split, white, *turned, switches=switches)


def switch_off(spheres: list[Sphere]) -> None:
    """The pure theory where Cycles shows a Glossy BSDF."""
    groups = nodes.groups()
    for sphere in spheres:
        if sphere.is_glossy:
            tree = bpy.data.objects[sphere.name].active_material.node_tree
            (ours,) = (n for n in tree.nodes if n.type == "GROUP" and n.node_tree in groups)
            for name in SWITCHES:
                ours.inputs[name].default_value = 0


def strip(path: Path, hdri: str, folder: Path) -> None:
    """Paint and gold in EEVEE, then in Cycles, before grey."""
    specular_scene.build(specular_scene.spheres(with_glossy=False), hdri, TURN, STRIP)
    bpy.context.scene.render.film_transparent = True
    picture_bakes.bake_all(SETTINGS)
    eevee = picture_truth.eevee(folder, SAMPLES)
    cycles = picture_truth.cycles(folder, 16 * SAMPLES, 1)
    rows = [picture_truth.colour(one) + GREY * (1 - one["Combined.A"][..., None])
            for one in (eevee, cycles)]  # fmt: skip
    picture_files.save(path, np.concatenate(rows))


if __name__ == "__main__":
    main()
