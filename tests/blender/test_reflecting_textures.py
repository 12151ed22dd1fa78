"""A group that reflects and reads a texture shows what numpy says of its texels."""

import numpy as np
import pytest
import test_reflections as reflecting
import textured
from bakes import principled, quad
from pictures import colour, look_down, render, show_exit
from prt_baker.addon import atlas_images, nodes, reflections, writeback
from prt_baker.addon.light_state import LightState
from prt_baker.addon.prt import layout as layouts
from prt_baker.addon.prt.files.atlases import write_tiles
from prt_baker.addon.prt.layout import Layout
from prt_baker.addon.prt.specular import occlusion, shading, sheet
from prt_baker.addon.prt.tracing.visibility import EVERYTHING

made, reflected, scene = reflecting.made, reflecting.reflected, reflecting.scene

SIZE = 8
ROUGHNESS, METALLIC = 0.6, 0.7
LIGHT = np.zeros((25, 3))
LIGHT[0] = 1.0
LIGHT[1:9] = np.random.default_rng(0).normal(0, 0.1, (8, 3))


def atlas(folder, layout):
    """An image of random texels, all of a layout, and these."""
    values = [textured.smooth(v, SIZE) for v in textured.random_values(layout, SIZE * SIZE)]
    rng = np.random.default_rng(1)
    seen = rng.normal(0, 0.3, (SIZE * SIZE, layout.visibility_order**2))
    seen[:, :1] = rng.uniform(0.3, 0.9) * EVERYTHING
    whole = layouts.Values(*values, textured.smooth(seen, SIZE))
    names = [slot for slot in layout.slots if slot]
    packed = layouts.pack(layout, whole)[:, : len(names)].reshape(SIZE, SIZE, -1)
    write_tiles(folder / "a.exr", packed, names, half=False, metadata={"prtBaker": "test"})
    image = atlas_images.load(folder / "a.exr", "Atlas", atlas_images.Atlas(SIZE, 0.5, "test"))
    return image, packed


@pytest.mark.parametrize(
    "layout", [Layout(3, 1, 1, 0, 3), Layout(2, 3, 0, 1, 2), Layout(2)], ids=str
)
def test_texels_are_shown_and_occlude_what_is_reflected(scene, made, reflected, tmp_path, layout):
    material = principled(Base_Color=(*reflecting.BASE, 1), Metallic=METALLIC, Roughness=ROUGHNESS)
    obj = quad(scene, material=material)
    image, packed = atlas(tmp_path, layout)
    with reflections.loaded(reflected(), "") as sky:
        writeback.write(scene, [textured.bake(obj, layout, SIZE)], layout, [image], sky)
    turn, strength = reflecting.rows(reflecting.TURN), reflecting.STRENGTH
    writeback.set_light(LightState("", LIGHT, LIGHT, LIGHT, True, (), turn, strength))
    assert image.name in {n.image.name for n in nodes.groups()[0].nodes if n.type == "TEX_IMAGE"}
    show_exit(scene, material)
    look_down(scene, 1, 1)
    scene.render.resolution_x = scene.render.resolution_y = 30
    shown = colour(render(scene, tmp_path), "Exit")
    texels = textured.bilinear(packed, centres(30).reshape(-1, 2))
    np.testing.assert_allclose(shown.reshape(-1, 3), expected(made, layout, texels), atol=5e-3)


def centres(count):
    """u and v (count, count, 2) of the pixels of a square that fills the picture."""
    middles = (np.arange(count) + 0.5) / count
    return np.stack(np.meshgrid(middles, middles[::-1]), axis=-1)


def expected(made, layout, texels):
    """The exit radiance (P, 3) of ``texels`` (P, K) that face the camera."""
    found = layouts.unpack(layout, np.float32(texels))
    count, up = len(texels), np.tile([0.0, 0, 1], (len(texels), 1))
    three = np.repeat(found.transfer, 3 // layout.channels, axis=1)
    white = np.einsum("pci,ic->pc", three, LIGHT[: layout.order**2])
    white = np.maximum(white + found.residual.sum(axis=1), 0)
    surface = shading.Surface(reflecting.BASE, METALLIC, ROUGHNESS)
    split = sheet.split_sum(made[1], np.full(count, ROUGHNESS), np.ones(count))
    diffuse, specular = shading.parts(surface, split)
    towards, filtered = shading.look_up(up, up, ROUGHNESS)
    lit = sheet.radiance(*made, towards @ reflecting.TURN.T, filtered) * reflecting.STRENGTH
    if layout.visibility_order:
        lobe = occlusion.occlusion(found.visibility_sh, towards, sheet.zonal_factors(filtered))
        light = occlusion.brightened(LIGHT, layout.order)
        lit = lit * occlusion.share(lobe, occlusion.arriving(found.transfer, up, light), ROUGHNESS)
    return diffuse * white + specular * lit
