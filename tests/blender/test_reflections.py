"""What EEVEE reflects is numpy's of the documented formula; what is not shiny pays nothing."""

from dataclasses import replace
from math import radians

import bpy
import numpy as np
import pytest
from bakes import constant_bake, principled, quad, shader
from mathutils import Matrix, Vector
from pictures import colour, look_down, render, show_exit
from prt_baker.addon import (
    material_samplers,
    nodes,
    reflections,
    write_checks,
    writeback,
)
from prt_baker.addon.light_state import LightState
from prt_baker.addon.prt.errors import BakeError
from prt_baker.addon.prt.files import images
from prt_baker.addon.prt.job import Job, LightSource, Peak, Settings
from prt_baker.addon.prt.layout import Layout
from prt_baker.addon.prt.light import lat_long
from prt_baker.addon.prt.results import Reflections
from prt_baker.addon.prt.specular import brdf, shading, sheet

BASE = (0.9, 0.6, 0.3)
TURN = np.array(Matrix.Rotation(radians(40), 3, "Z") @ Matrix.Rotation(radians(25), 3, "X"))
STRENGTH = (0.5, 0.6, 0.7)
SUN = Peak((0.0, -0.6, 0.8), (3.0, 2.0, 1.0), 0.05)
FLAT = np.zeros((25, 3))
FLAT[0] = 0.3  # of a constant bake: the exit radiance of a white surface


@pytest.fixture(scope="module")
def made():
    """A sky of three colours, small, as half floats."""
    towards = lat_long.directions(64, 128)
    pixels = (1 + 0.6 * np.sin(4 * towards + [0, 1, 2])).astype(np.float32)
    its_sheet, image = sheet.make(pixels, cell=(144, 72))
    return its_sheet, image.astype(np.float16)


@pytest.fixture
def reflected(made, tmp_path):
    """Writes ``made`` as a run of the engine would."""

    def write(peaks=()):
        path = tmp_path / "reflections.exr"
        images.write_rgba(str(path), made[1][::-1].astype(np.float32), half=True)
        return Reflections(made[0], tuple(peaks), path=path)

    return write


@pytest.fixture
def scene(registered):
    bpy.ops.wm.read_factory_settings(use_empty=True)
    return bpy.context.scene


def sphere(scene, material, x):
    """A smooth one of unit diameter about (x, 0.5, 0)."""
    bpy.ops.mesh.primitive_uv_sphere_add(segments=48, ring_count=24, radius=0.5)
    obj = bpy.context.object
    bpy.ops.object.shade_smooth()
    obj.location = x, 0.5, 0
    obj.data.materials.append(material)
    bpy.context.view_layer.update()
    return obj


def write(scene, found, layout, objects):
    baked = [constant_bake(obj, layout) for obj in objects]
    with reflections.loaded(found, "") as image:
        writeback.write(scene, baked, layout, (), image)
    writeback.set_light(LightState("", FLAT, FLAT, FLAT, True, (), rows(TURN), STRENGTH))
    return baked


def rows(matrix):
    return tuple(tuple(map(float, row)) for row in matrix)


def seen(scene, obj):
    """Pixels (P, 2) in which ``obj`` is seen from above, not at its border, and its normals."""
    pixels, normals = [], []
    mesh = obj.data
    mesh.calc_loop_triangles()
    vertices = np.array([v.co for v in mesh.vertices])
    smooth = np.array([v.vector for v in mesh.vertex_normals])
    corners = {t.polygon_index: [] for t in mesh.loop_triangles}
    for triangle in mesh.loop_triangles:
        corners[triangle.polygon_index].append(list(triangle.vertices))
    width, height = scene.render.resolution_x, scene.render.resolution_y
    scale = max(width, height) / scene.camera.data.ortho_scale
    for row in range(height):
        for column in range(width):
            x, y = (column + 0.5) / scale, (height - row - 0.5) / scale
            start = Vector((x, y, 5)) - obj.location
            hit, place, _, polygon = obj.ray_cast(start, Vector((0, 0, -1)))
            if hit:
                normal = interpolated(np.array(place), corners[polygon], vertices, smooth)
                if normal[2] > 0.15:
                    pixels.append((row, column))
                    normals.append(normal)
    return np.array(pixels), np.array(normals)


def interpolated(place, triangles, vertices, smooth):
    """The unit normal at ``place`` in one of ``triangles``."""
    best = max(
        (np.linalg.lstsq(vertices[t].T, place, rcond=None)[0] for t in triangles),
        key=lambda weights: weights.min(),
    )
    inside = triangles[
        int(
            np.argmax(
                [np.linalg.lstsq(vertices[t].T, place, rcond=None)[0].min() for t in triangles]
            )
        )
    ]
    normal = best @ smooth[inside]
    return normal / np.linalg.norm(normal)


def by_formula(made, surface, normals, bent=True, compensated=True):
    views = np.tile([0.0, 0, 1], (len(normals), 1))
    n_v = (normals * views).sum(axis=1).clip(0, 1)
    rough = np.full(len(normals), surface.roughness)
    diffuse, specular = shading.parts(
        surface, sheet.split_sum(made[1], rough, n_v), compensated=compensated
    )
    towards, filtered = shading.look_up(normals, views, surface.roughness, bent=bent)
    lit = sheet.radiance(*made, towards @ TURN.T, filtered) * STRENGTH
    return diffuse * FLAT[0] + specular * lit


SURFACES = [
    shading.Surface(BASE, metallic, roughness)
    for metallic in (0.0, 1.0)
    for roughness in (0.05, 0.2, 0.6, 1.0)
] + [shading.Surface(BASE, 0.4, 0.35, 1.8, 0.7, (1.0, 0.8, 0.6))]


def test_spheres_reflect_what_the_formula_says(scene, made, reflected, tmp_path):
    objects, found = [], []
    for k, surface in enumerate(SURFACES):
        material = principled(
            Base_Color=(*BASE, 1),
            Metallic=surface.metallic,
            Roughness=surface.roughness,
            IOR=surface.ior,
            Specular_IOR_Level=surface.level,
            Specular_Tint=(*surface.tint, 1),
        )
        objects.append(sphere(scene, material, 0.5 + k))
    write(scene, reflected(), Layout(2), objects)
    groups = [show_exit(scene, obj.active_material) for obj in objects]
    assert len({group.node_tree for group in groups}) == 1
    look_down(scene, len(SURFACES), 1)
    scene.render.resolution_x, scene.render.resolution_y = 30 * len(SURFACES), 30
    shown = colour(render(scene, tmp_path), "Exit")
    for surface, obj in zip(SURFACES, objects, strict=True):
        pixels, normals = seen(scene, obj)
        assert len(pixels) > 400
        want = by_formula(made, surface, normals)
        found.append(np.abs(shown[pixels[:, 0], pixels[:, 1]] - want).max())
    assert max(found) < 5e-3


def test_switches_and_bent_normals(scene, made, reflected, tmp_path):
    surface = shading.Surface(BASE, 1.0, 0.8)
    plain, mapped = (principled(Base_Color=(*BASE, 1), Metallic=1, Roughness=0.8) for _ in "ab")
    tilted = mapped.node_tree.nodes.new("ShaderNodeCombineXYZ")
    given = np.array([0.6, 0.0, 0.8])
    for socket, value in zip(tilted.inputs, given, strict=True):
        socket.default_value = value
    mapped.node_tree.links.new(tilted.outputs[0], shader(mapped).inputs["Normal"])
    quads = [quad(scene, 0, material=plain), quad(scene, 1.0, material=mapped, name="Mapped")]
    write(scene, reflected(), Layout(2), quads)
    groups = [show_exit(scene, material) for material in (plain, mapped)]
    for name in ("Energy Compensation", "Rough Look-up"):
        groups[0].inputs[name].default_value = 0
    look_down(scene, 2, 1)
    shown = colour(render(scene, tmp_path), "Exit")
    up = np.array([[0.0, 0, 1]])
    pure = by_formula(made, surface, up, bent=False, compensated=False)
    assert shown[5, 5] == pytest.approx(pure[0], abs=5e-3)
    assert shown[5, 15] == pytest.approx(by_formula(made, surface, given[None])[0], abs=5e-3)


def test_a_lamp_cut_out_gives_a_highlight_that_its_shadow_takes_away(
    scene, made, reflected, tmp_path
):
    roughness, layout = 0.4, Layout(2, lights=1)
    material = principled(Base_Color=(*BASE, 1), Metallic=1, Roughness=roughness)
    lit, dark = quad(scene, 0, material=material), quad(scene, 1, material=material, name="Dark")
    baked = [constant_bake(obj, layout) for obj in (lit, dark)]
    to_sun = TURN.T @ SUN.direction
    shadows = float(to_sun[2]), 0.0
    assert to_sun[2] > 0.2
    for (_, result, _), value in zip(baked, shadows, strict=True):
        result.visibility[:] = value
    with reflections.loaded(reflected([SUN]), "") as image:
        writeback.write(scene, baked, layout, (), image)
    writeback.set_light(LightState("", FLAT, FLAT, FLAT, True, (), rows(TURN), STRENGTH))
    show_exit(scene, material)
    look_down(scene, 2, 1)
    shown = colour(render(scene, tmp_path), "Exit")
    half = to_sun + np.array([0, 0, 1])
    half /= np.linalg.norm(half)
    wide = min(1, roughness**4 + (SUN.angular_radius / 2) ** 2)
    k, v_h = brdf.light_k(roughness), half[2]
    f = np.array(BASE) + (1 - np.array(BASE)) * (1 - v_h) ** 5
    split = sheet.split_sum(made[1], [roughness], [1.0])[0]
    f *= 1 + np.array(BASE) * (1 / split.sum() - 1)
    d = brdf.distribution(np.sqrt(wide), half[2]) / 4 * brdf.visible_part(k, to_sun[2])
    want = f * d * to_sun[2] * np.array(STRENGTH) * SUN.irradiance
    assert want.max() > 0.05
    assert shown[5, 5] - shown[5, 15] == pytest.approx(want, abs=5e-3)


def test_one_image_one_sampler(scene, reflected):
    """Whatever the layout: all reads are one texture to EEVEE, and no attribute is added."""
    layouts = [
        Layout(2, 1, 0, 0, 0),
        Layout(3, 1, 1, 4, 3),
        Layout(3, 3, 1, 0, 3),
        Layout(5, 1, 1, 4, 2),
        Layout(4, 3, 1, 0, 0),
    ]
    peaks = [SUN] * 4
    with reflections.loaded(reflected(peaks), "") as image:
        for layout in layouts:
            plain, shiny = nodes.group(layout), nodes.group(layout, None, image)
            read = {
                (node.image.name, node.interpolation, node.extension)
                for node in shiny.nodes
                if node.type == "TEX_IMAGE"
            }
            assert read == {(image.name, "Closest", "EXTEND")}
            assert attributes(shiny) == attributes(plain)
            assert not any(node.type in ("TEX_IMAGE", "CURVE_FLOAT") for node in plain.nodes)


def attributes(tree):
    return {n.attribute_name for n in tree.nodes if n.type == "ATTRIBUTE"}


def test_too_many_textures_are_refused(scene):
    material = principled(Metallic=1)
    total = None
    for k in range(material_samplers.MOST):
        texture = material.node_tree.nodes.new("ShaderNodeTexImage")
        texture.image = bpy.data.images.new(f"Own {k}", 4, 4)
        term = material.node_tree.nodes.new("ShaderNodeVectorMath")
        material.node_tree.links.new(texture.outputs[0], term.inputs[0])
        if total is not None:
            material.node_tree.links.new(total, term.inputs[1])
        total = term.outputs[0]
    material.node_tree.links.new(total, shader(material).inputs["Base Color"])
    obj = quad(scene, material=material)
    write_checks.check(scene, [obj], Layout(3))
    with pytest.raises(BakeError, match="reads 30 textures, and EEVEE at most 30, one of them"):
        write_checks.check(scene, [obj], Layout(3), reflections=True)


def test_an_engine_job_says_whether_it_reflects():
    assert Job("light", Settings(), LightSource()).settings.reflections is False
    assert replace(Settings(), reflections=True) != Settings()
