"""What EEVEE shows through the node group of an atlas is what numpy says of its texels."""

import bpy
import numpy as np
import pytest
import textured
from bakes import place, principled, quad
from pictures import colour, look_down, pixel_centres, render, show_exit
from prt_baker.addon import stamp, writeback
from prt_baker.addon.light_state import LightState
from prt_baker.addon.prt.layout import Layout
from prt_baker.addon.prt.results import ReceiverResult
from test_nodes import ALBEDO, exit_radiance, light  # noqa: F401

SIZE = 8
LAYOUTS = [
    *(Layout(order, turns=1) for order in (2, 3, 4, 5)),
    Layout(2),
    Layout(4, 3),
    Layout(5, 3, 1, 2),
    Layout(3, turns=12, lights=1),
]


def objects_of(scene, row):
    """Squares: a plain one, a subdivided one, two that share their mesh."""
    material = principled(Base_Color=(*ALBEDO, 1))
    made = [quad(scene, 1.1 * column, 1.1 * row, material) for column in range(2)]
    modifier = made[1].modifiers.new("Subdivision", "SUBSURF")
    modifier.subdivision_type, modifier.levels, modifier.render_levels = "SIMPLE", 1, 2
    made.append(place(scene, made[0].data.copy(), 2.2, 1.1 * row))
    made.append(place(scene, made[2].data, 3.3, 1.1 * row))
    bpy.context.view_layer.update()
    return made


def test_eevee_shows_albedo_times_exit_radiance(scene, light, tmp_path):  # noqa: F811
    look_down(scene, 6, 9)
    scene.camera.location.x += 0.0125
    cases = []
    for row, layout in enumerate(LAYOUTS):
        objects = objects_of(scene, row)
        baked, _, values = textured.write(scene, tmp_path, layout, *objects, size=SIZE, seed=row)
        assert [mark.by_modifier for _, _, mark in baked] == [False, True, True, True]
        show_exit(scene, objects[0].data.materials[0])
        texels = ReceiverResult("", values[0], textured.NOTHING, values[1], values[2])
        cases += [(obj, texels) for obj in objects]
    shares = [1.0, 1.0, 0.0, 2.0] * len(LAYOUTS)
    for (obj, _), share in zip(cases, shares, strict=True):
        stamp.set_share(obj, share)
    writeback.set_light(light)
    picture = render(scene, tmp_path)
    centres = pixel_centres(scene) + np.array([0.0125, 0])
    errors = []
    for (obj, texels), share in zip(cases, shares, strict=True):
        uvs = centres - np.array(obj.location.xy)
        seen = ((uvs > 0) & (uvs < 1)).all(axis=-1)
        assert seen.sum() > 80
        radiance = exit_radiance(texels, light, share).reshape(SIZE, SIZE, 3)
        truth = ALBEDO * np.maximum(textured.bilinear(radiance, uvs[seen]), 0)
        bound = 2e-3 * truth.mean(axis=0)
        shown = [colour(picture, name)[seen] for name in ("Exit", "Combined")]
        errors += [np.abs(each - truth).max(axis=0) / bound for each in shown]
    assert np.max(errors) < 1, np.max(errors, axis=1).round(2)


@pytest.mark.parametrize("margin", [0.5, 2])
def test_no_tile_shows_in_another_when_it_is_far_away(scene, tmp_path, margin):
    """A tile of ones beside tiles of a million: reads of lower mip levels stay inside it, as far
    as the surface keeps away from the border of the atlas."""
    layout, size = Layout(3, turns=1), 64
    image, _ = textured.atlas(tmp_path, layout, size, margin=margin)
    pixels = np.ones((2 * size, 2 * size, 4), np.float32)
    pixels[size:, size:] = pixels[:size] = 1e6
    image.pixels.foreach_set(pixels.ravel())
    image.update()
    obj = quad(scene, material=principled())
    inset = (margin + 0.01) / size
    uvs = inset + (1 - 2 * inset) * textured.plane_uvs(obj)
    writeback.write(scene, [textured.bake(obj, layout, size, uvs)], layout, [image])
    stamp.set_share(obj, 0.0)
    first = np.zeros((25, 3))
    first[0] = 1
    writeback.set_light(LightState("", first, first, first))
    look_down(scene, 1, 1)
    scene.render.resolution_x = scene.render.resolution_y = round(size / (2 * margin))
    picture = colour(render(scene, tmp_path), "Combined")
    np.testing.assert_allclose(picture, 0.8, rtol=2e-3)


def test_no_read_takes_a_mip_level(scene, tmp_path):
    """It would be the coarsest at some pixels of a chart's border, a mean of all tiles."""
    obj = quad(scene, material=principled())
    _, image, _ = textured.write(scene, tmp_path, Layout(3, turns=1), obj)
    reads = [
        node
        for tree in bpy.data.node_groups
        for node in tree.nodes
        if node.type == "TEX_IMAGE" and node.image == image
    ]
    assert len(reads) == 4 * 3  # texels of each tile
    assert {node.interpolation for node in reads} == {"Closest"}
