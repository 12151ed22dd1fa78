"""Reflections grow dark where what stands before them is baked, and nowhere else."""

from dataclasses import replace

import numpy as np
import pytest
import test_reflections as reflecting
from bakes import constant_bake, principled
from pictures import colour, look_down, render, show_exit
from prt_baker.addon import nodes, occlusion_nodes, reflections, writeback
from prt_baker.addon.light_state import LightState
from prt_baker.addon.prt.layout import Layout
from prt_baker.addon.prt.light.residual import peaks_sh
from prt_baker.addon.prt.specular import shading, sheet
from prt_baker.addon.prt.specular.occlusion import arriving, brightened, occlusion
from prt_baker.addon.prt.specular.occlusion import share as blended
from prt_baker.addon.prt.tracing.visibility import EVERYTHING

made, reflected, scene = reflecting.made, reflecting.reflected, reflecting.scene

SIDE = np.array([0.45, 0.3, -0.2, -0.5, 0.1, -0.1, 0.05, 0.2, -0.15])  # of V, beside all
SEEN = [EVERYTHING * np.eye(1, 9)[0], 0.5 * EVERYTHING * np.eye(1, 9)[0] + SIDE, np.zeros(9)]
TRANSFER = [[0.15, 0.05, -0.04, 0.03]]
LIGHT = np.zeros((25, 3))
LIGHT[:4] = [[0.3, 0.4, 0.5], [0.1, 0.0, 0.1], [-0.2, 0.5, 0.1], [0.1, 0.1, -0.2]]
ROUGHNESSES = (0.3, 0.8)


def test_the_share_of_a_lobe_that_is_seen_is_reflected(scene, made, reflected, tmp_path):
    layout, baked, cases = Layout(2, visibility_order=3), [], []
    for roughness in ROUGHNESSES:
        material = principled(Base_Color=(*reflecting.BASE, 1), Metallic=1, Roughness=roughness)
        for coefficients in SEEN:
            obj = reflecting.sphere(scene, material, 0.5 + len(baked))
            one = constant_bake(obj, layout)
            one[1].visibility_sh[:] = coefficients
            one[1].transfer[:] = TRANSFER
            baked.append(one)
            cases.append((obj, roughness, coefficients))
    with reflections.loaded(reflected(), "") as image:
        writeback.write(scene, baked, layout, (), image)
    turn = reflecting.rows(reflecting.TURN)
    writeback.set_light(LightState("", LIGHT, LIGHT, LIGHT, True, (), turn, reflecting.STRENGTH))
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
        towards, filtered = shading.look_up(normals, views, roughness)
        seen = np.tile(coefficients, (len(normals), 1))
        lobe = occlusion(seen, towards, sheet.zonal_factors(filtered))
        transfer = np.tile(TRANSFER, (len(normals), 1, 1))
        share = blended(lobe, arriving(transfer, normals, brightened(LIGHT, 2)), roughness)
        found = shown[pixels[:, 0], pixels[:, 1]]
        assert found == pytest.approx(whole * share, abs=5e-3)


def test_lamps_that_are_not_reflected_do_not_weigh(scene, reflected):
    """What arrives is asked for the light of the picture, which is without them."""
    layout, sun = Layout(2, lights=1, visibility_order=2), reflecting.SUN
    strength, turn = np.array(reflecting.STRENGTH), reflecting.TURN
    irradiance, direction = strength * sun.irradiance, turn.T @ sun.direction
    there = replace(sun, direction=tuple(direction), irradiance=tuple(irradiance))
    whole = LIGHT + peaks_sh((there,))
    with reflections.loaded(reflected([sun]), "") as image:
        tree = nodes.group(layout, None, image)
        state = LightState("", whole, whole, whole, True, (there,), reflecting.rows(turn), strength)
        nodes.set_light(state)
    light = brightened(LIGHT, 2)
    for i, factor in enumerate(occlusion_nodes.open_factors(2)):
        assert tuple(tree.nodes[f"M{i}"].inputs[1].default_value) == pytest.approx(light[i])
        assert tuple(tree.nodes[f"O{i}"].inputs[1].default_value) == pytest.approx(
            factor * light[i]
        )
