"""A real HDRI in a sphere: EEVEE shows the formula, and that is near what the BRDF reflects."""

import importlib.util
from pathlib import Path

import bpy
import numpy as np
import pytest
import test_reflections as reflecting
from bakes import principled
from pictures import colour, look_down, render, show_exit
from prt_baker.addon.prt.files import images
from prt_baker.addon.prt.layout import Layout
from prt_baker.addon.prt.light.projection import repair
from prt_baker.addon.prt.results import Reflections
from prt_baker.addon.prt.specular import shading, sheet

scene = reflecting.scene
SPHERES = [shading.Surface(reflecting.BASE, 1.0, r) for r in (0.2, 0.4, 0.6, 0.8, 1.0)]
SPHERES.append(shading.Surface(reflecting.BASE, 0.0, 0.2))
UP = np.array([0.0, 0, 1])


def sunset():
    """One that comes with Blender, a quarter as wide and high: (128, 256, 3)."""
    path = Path(bpy.utils.system_resource("DATAFILES")) / "studiolights" / "world" / "sunset.exr"
    pixels, _ = repair(images.read(str(path)))
    return pixels.reshape(128, 4, 256, 4, 3).mean(axis=(1, 3))


@pytest.fixture(scope="module")
def hdri():
    """Its pixels, and what EEVEE reads of it."""
    pixels = sunset()
    its_sheet, image = sheet.make(pixels, cell=(256, 128))
    return pixels, (its_sheet, image.astype(np.float16))


@pytest.fixture(scope="module")
def sums(root):
    """benchmarks/specular_sums.py, which is no part of the package."""
    path = root / "benchmarks" / "specular_sums.py"
    spec = importlib.util.spec_from_file_location("specular_sums", path)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def relative(found, expected):
    return np.sqrt(np.square(found - expected).mean() / np.square(expected).mean())


def test_eevee_shows_the_formula_under_a_real_hdri(scene, hdri, tmp_path):
    made, objects = hdri[1], []
    for k, surface in enumerate(SPHERES):
        material = principled(
            Base_Color=(*surface.base, 1),
            Metallic=surface.metallic,
            Roughness=surface.roughness,
        )
        objects.append(reflecting.sphere(scene, material, 0.5 + k))
    path = tmp_path / "reflections.exr"
    images.write_rgba(str(path), made[1][::-1].astype(np.float32), half=True)
    reflecting.write(scene, Reflections(made[0], (), path=path), Layout(2), objects)
    for obj in objects:
        show_exit(scene, obj.active_material)
    look_down(scene, len(SPHERES), 1)
    scene.render.resolution_x, scene.render.resolution_y = 30 * len(SPHERES), 30
    scene.render.use_high_quality_normals = True  # else EEVEE keeps 10 bits of them
    shown = colour(render(scene, tmp_path), "Exit")
    for surface, obj in zip(SPHERES, objects, strict=True):
        pixels, normals = reflecting.seen(scene, obj)
        want = reflecting.by_formula(made, surface, normals)
        found = shown[pixels[:, 0], pixels[:, 1]]
        assert relative(found, want) < 5e-3, surface


@pytest.mark.parametrize("surface", SPHERES[1:5], ids=lambda surface: str(surface.roughness))
def test_the_formula_is_near_the_whole_brdf(hdri, sums, surface):
    pixels, (its_sheet, image) = hdri
    spread = np.random.default_rng(0).uniform(-1, 1, (400, 2))
    spread = spread[(spread**2).sum(axis=1) < 0.97]
    normals = np.column_stack([spread, np.sqrt(1 - (spread**2).sum(axis=1))])
    split = sheet.split_sum(image, np.full(len(normals), surface.roughness), normals @ UP)
    texels = sums.Sky(pixels).sums(normals, UP, surface.roughness)
    whole = texels.exit_radiance(surface, split)
    bent, plain = (
        sums.formula(image, its_sheet, surface, split, texels.white, normals, UP, switches=on)
        for on in (True, False)
    )
    assert relative(bent, whole) < 0.2
    assert relative(bent, whole) < relative(plain, whole)
