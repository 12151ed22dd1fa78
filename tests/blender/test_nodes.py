"""What EEVEE shows through the node group is numpy's albedo times the sum of transfer and light."""

import bpy
import numpy as np
import pytest
from bakes import place, principled, quad, random_bake
from pictures import colour, look_down, pixel_centres, render
from prt_baker.addon import carrier, writeback
from prt_baker.addon.prt.layout import Layout

ALBEDO = np.array([0.9, 0.7, 0.5])
LAYOUTS = [Layout(order) for order in (2, 3, 4, 5)] + [Layout(order, 3) for order in (2, 3, 4)]


@pytest.fixture(scope="module")
def light():
    """Its constant part prevails: EEVEE's passes are half floats, as good as 1e-3 of a value."""
    coefficients = np.random.default_rng(3).normal(0, 0.1, (25, 3))
    coefficients[0] = 1
    return coefficients


def aov(scene, material):
    """Show the group's Exit Radiance in a pass of its own, which EEVEE keeps in float."""
    if "Exit" not in scene.view_layers[0].aovs:
        scene.view_layers[0].aovs.add().name = "Exit"
    tree = material.node_tree
    group = next(node for node in tree.nodes if node.type == "GROUP")
    output = tree.nodes.new("ShaderNodeOutputAOV")
    output.aov_name = "Exit"
    tree.links.new(group.outputs["Exit Radiance"], output.inputs["Color"])


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


def expected(obj, domain, transfer, light, centres):
    radiance = np.einsum(
        "eci,ic->ec",
        np.broadcast_to(transfer, (len(transfer), 3, transfer.shape[2])),
        light[: transfer.shape[2]],
    )
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


def test_eevee_shows_albedo_times_transfer_times_light(scene, light, tmp_path):
    look_down(scene, 6, 8)
    scene.camera.location.x += 0.0125
    cases = []
    for row, layout in enumerate(LAYOUTS):
        baked = [
            random_bake(obj, layout, domain, seed)
            for seed, (obj, domain) in enumerate(objects_of(scene, layout, row))
        ]
        writeback.write(scene, baked, layout)
        aov(scene, baked[0][0].data.materials[0])
        cases += baked
    assert [stamp.by_modifier for _, _, stamp in cases] == [False, False, True, True, True] * len(
        LAYOUTS
    )
    assert writeback.set_light(light)
    assert not writeback.set_light(light)
    picture = render(scene, tmp_path)
    centres = pixel_centres(scene) + np.array([0.0125, 0])
    for obj, result, stamp in cases:
        truth = expected(obj, stamp.domain, result.transfer, light, centres)
        seen = np.isfinite(truth).all(-1)
        assert seen.sum() > 80
        mean = truth[seen].mean()
        assert np.abs(colour(picture, "Exit") - truth)[seen].max() < 2e-3 * mean
        assert np.abs(colour(picture, "Combined") - truth)[seen].max() < 2e-3 * mean
