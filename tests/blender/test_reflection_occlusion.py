"""Reflections grow dark where what stands before them is baked, and nowhere else."""

import numpy as np
import pytest
import test_reflections as reflecting
from bakes import constant_bake, principled
from pictures import colour, look_down, render, show_exit
from prt_baker.addon import reflections, writeback
from prt_baker.addon.light_state import LightState
from prt_baker.addon.prt.layout import Layout
from prt_baker.addon.prt.specular import shading, sheet
from prt_baker.addon.prt.specular.occlusion import occlusion
from prt_baker.addon.prt.tracing.visibility import EVERYTHING

made, reflected, scene = reflecting.made, reflecting.reflected, reflecting.scene

SIDE = np.array([0.45, 0.3, -0.2, -0.5, 0.1, -0.1, 0.05, 0.2, -0.15])  # of V, beside all
SEEN = [EVERYTHING * np.eye(1, 9)[0], 0.5 * EVERYTHING * np.eye(1, 9)[0] + SIDE, np.zeros(9)]
ROUGHNESSES = (0.3, 0.8)


def test_the_share_of_a_lobe_that_is_seen_is_reflected(scene, made, reflected, tmp_path):
    layout, baked, cases = Layout(2, visibility_order=3), [], []
    for roughness in ROUGHNESSES:
        material = principled(Base_Color=(*reflecting.BASE, 1), Metallic=1, Roughness=roughness)
        for coefficients in SEEN:
            obj = reflecting.sphere(scene, material, 0.5 + len(baked))
            one = constant_bake(obj, layout)
            one[1].visibility_sh[:] = coefficients
            baked.append(one)
            cases.append((obj, roughness, coefficients))
    with reflections.loaded(reflected()) as image:
        writeback.write(scene, baked, layout, (), image)
    flat, turn = reflecting.FLAT, reflecting.rows(reflecting.TURN)
    writeback.set_light(LightState("", flat, flat, flat, True, (), turn, reflecting.STRENGTH))
    for material in {obj.active_material for obj, _, _ in cases}:
        show_exit(scene, material)
    look_down(scene, len(cases), 1)
    scene.render.resolution_x, scene.render.resolution_y = 30 * len(cases), 30
    shown = colour(render(scene, tmp_path), "Exit")
    for obj, roughness, coefficients in cases:
        pixels, normals = reflecting.seen(scene, obj)
        surface = shading.Surface(reflecting.BASE, 1.0, roughness)
        whole = reflecting.by_formula(made, surface, normals)
        views = np.tile([0.0, 0, 1], (len(normals), 1))
        share = occlusion(
            np.tile(coefficients, (len(normals), 1)),
            shading.look_up(normals, views, roughness),
            sheet.zonal_factors(roughness),
        )
        found = shown[pixels[:, 0], pixels[:, 1]]
        assert found == pytest.approx(whole * share[:, None], abs=5e-3)
