"""What EEVEE shows through the node group is what numpy says of the stored values and the light."""

from dataclasses import replace
from math import radians

import bpy
import numpy as np
import pytest
from bakes import place, principled, quad, random_bake, write
from mathutils import Matrix
from pictures import colour, look_down, pixel_centres, render, show_exit
from prt_baker.addon import carrier, stamp, writeback
from prt_baker.addon.light_state import LightState
from prt_baker.addon.prt import sh
from prt_baker.addon.prt.job import Peak
from prt_baker.addon.prt.layout import Layout
from prt_baker.addon.prt.light import residual

ALBEDO = np.array([0.9, 0.7, 0.5])
LAYOUTS = [Layout(order) for order in (2, 3, 4, 5)] + [Layout(order, 3) for order in (2, 3, 4)]
EXACT = [Layout(3, turns=1), Layout(3, turns=12), Layout(2, 3, 1, 3), Layout(4, lights=1)]
PEAKS = tuple(
    Peak(tuple(direction / np.linalg.norm(direction)), (0.5, 0.4 * k, 0.3), 0.1 * k)
    for k, direction in enumerate(np.random.default_rng(4).normal(size=(3, 3)))
)
TURN = 5  # degrees, by which the light has been turned since the bake
TINT = np.array([1.2, 1.1, 1.0])


@pytest.fixture(scope="module")
def light():
    """Its constant part prevails: EEVEE's passes are half floats, as good as 1e-3 of a value."""
    baked = np.random.default_rng(3).normal(0, 0.1, (25, 3))
    baked[0] = 1
    turned = sh.rotate(baked, Matrix.Rotation(radians(TURN), 3, "Z")) * TINT
    return LightState("", turned, turned, baked, peaks=PEAKS)


def interpolated(obj, domain, values, centres):
    """Values (E, n) seen at world places (..., 2), by triangle; NaN beside the mesh."""
    shown = np.full((*centres.shape[:2], values.shape[1]), np.nan)
    with carrier.evaluated_mesh(obj, bpy.context.evaluated_depsgraph_get()) as mesh:
        mesh.calc_loop_triangles()
        for triangle in mesh.loop_triangles:
            corners = [mesh.vertices[v].co.xy + obj.location.xy for v in triangle.vertices]
            elements = triangle.vertices if domain == "POINT" else triangle.loops
            a, b, c = map(np.array, corners)
            weights = (centres - a) @ np.linalg.inv(np.stack([b - a, c - a]))
            weights = np.concatenate([1 - weights.sum(-1, keepdims=True), weights], -1)
            inside = (weights > 0).all(-1)
            shown[inside] = weights[inside] @ values[list(elements)]
    return shown


def summed(values, light):
    """Values (E, channels or 1, n) times light (n, 3): (E, 3)."""
    return np.einsum("eci,ic->ec", np.broadcast_to(values, (len(values), 3, len(light))), light)


def exit_radiance(result, light, share):
    """(E, 3) of a white surface: the documented formula, with the angle and the weight known."""
    count = result.transfer.shape[2]
    total = summed(result.transfer, light.radiance_sh[:count])
    turns, lights = result.residual.shape[1], result.visibility.shape[1]
    b = light.baked_radiance_sh[1:9]
    # Turned by the angle, the baked light is the present one but for its tint
    a = TINT * b if turns > 1 else light.radiance_sh[1:9]
    rho = (a * b).sum() / np.sqrt((a * a).sum() * (b * b).sum())
    weight = TINT * rho**16
    place = TURN / 360 * turns if turns > 1 else 0
    first = (1 - place) * weight
    if turns:
        total += share * first * result.residual[:, 0]
    if turns > 1:
        total += share * place * weight * result.residual[:, 1]
    if lights and share:
        irradiance = np.array([peak.irradiance for peak in PEAKS[:lights]])
        total += result.visibility @ (first * irradiance / np.pi)
        total -= summed(result.transfer, first * residual.peaks_sh(PEAKS[:lights])[:count])
    return total


def expected(obj, domain, radiance, centres):
    return ALBEDO * np.maximum(interpolated(obj, domain, radiance, centres), 0)


def objects_of(scene, layout, row):
    """Squares: plain ones for both domains, a subdivided one, two that share their mesh."""
    material = principled(Base_Color=(*ALBEDO, 1))
    made = [quad(scene, 1.1 * column, 1.1 * row, material) for column in range(3)]
    modifier = made[2].modifiers.new("Subdivision", "SUBSURF")
    modifier.subdivision_type, modifier.levels, modifier.render_levels = "SIMPLE", 1, 1
    shared = [place(scene, made[1].data.copy(), 3.3, 1.1 * row)]
    shared.append(place(scene, shared[0].data, 4.4, 1.1 * row))
    bpy.context.view_layer.update()
    return list(zip(made + shared, ("POINT", "CORNER", "CORNER", "POINT", "CORNER"), strict=True))


@pytest.mark.parametrize("layouts", [LAYOUTS, EXACT], ids=["transfer", "residuals and peaks"])
def test_eevee_shows_albedo_times_exit_radiance(scene, light, tmp_path, layouts):
    look_down(scene, 6, 8)
    scene.camera.location.x += 0.0125
    cases = []
    for row, layout in enumerate(layouts):
        baked = [
            random_bake(obj, layout, domain, seed)
            for seed, (obj, domain) in enumerate(objects_of(scene, layout, row))
        ]
        writeback.write(scene, baked, layout)
        show_exit(scene, baked[0][0].data.materials[0])
        cases += baked
    by_modifier = [mark.by_modifier for _, _, mark in cases]
    assert by_modifier == [False, False, True, True, True] * len(layouts)
    shares = [1.0, 1.0, 0.0, 2.0, 1.0] * len(layouts)
    for (obj, _, _), share in zip(cases, shares, strict=True):
        stamp.set_share(obj, share)
    assert writeback.set_light(light)
    assert not writeback.set_light(light)
    picture = render(scene, tmp_path)
    centres = pixel_centres(scene) + np.array([0.0125, 0])
    for (obj, result, mark), share in zip(cases, shares, strict=True):
        radiance = exit_radiance(result, light, share)
        truth = expected(obj, mark.domain, radiance, centres)
        seen = np.isfinite(truth).all(-1)
        assert seen.sum() > 80
        mean = truth[seen].mean()
        assert np.abs(colour(picture, "Exit") - truth)[seen].max() < 2e-3 * mean
        assert np.abs(colour(picture, "Combined") - truth)[seen].max() < 2e-3 * mean


def test_fewer_peaks_than_a_group_reads_leave_the_others_dark(scene, light):
    obj = quad(scene, material=principled())
    write(scene, Layout(2, lights=3), obj)
    writeback.set_light(replace(light, peaks=PEAKS[:1]))
    nodes = next(tree for tree in bpy.data.node_groups if "PRT" in tree.name).nodes
    held = [tuple(nodes[f"S{j}"].inputs[1].default_value) for j in range(3)]
    assert any(held[0])
    assert held[1:] == [(0, 0, 0)] * 2
