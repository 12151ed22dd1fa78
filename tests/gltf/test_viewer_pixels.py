"""The viewer's pixels, in a real browser, are what numpy makes of the .blend."""

import json
from dataclasses import replace
from pathlib import Path

import bpy
import numpy as np
import pytest
from gltf_scenes import mirrored, monkey, rotated, sheared
from gltf_textured import bake_in_texture
from gltf_worlds import colour, hdri
from prt_baker.addon import bake as baking
from prt_baker.addon import gltf_export, light_state
from prt_baker.addon.prt.job import Settings
from prt_baker.addon.prt.layout import Layout
from viewer_laws import HEIGHT, WIDTH, encoded, expected

OPEN = f"""
const {{ stage }} = viewer;
stage.resize({WIDTH}, {HEIGHT});
const said = await stage.loadModel(files.glb);
stage.resetEnvironment();
stage.turn({{ environment: 0, model: 0 }});
const {{ camera, pivot, controls }} = stage;
camera.position.lerp(controls.target, 0.45);
controls.update();
camera.updateMatrixWorld();
const pose = {{ matrix: camera.matrixWorld.elements, fov: camera.fov }};
return {{ ...said, ...pose, pivot: pivot.position.toArray() }};
"""
SEE = f"""
const {{ stage }} = viewer;
const {{ pixels, albedo, bounces, ...turns }} = asked;
stage.set({{ background: false, albedo, bounces }});
stage.turn(turns);
const of = (picture) => pixels.map((p) => Array.from(picture.slice(4 * p, 4 * p + 3)));
return [of(stage.readFloat({WIDTH}, {HEIGHT})), of(stage.readBytes())];
"""


def see(page, pixels, environment=0.0, model=0.0, **switches):
    """``pixels`` (H) of the picture, bottom row first, as floats and as bytes, (H, 3) each."""
    asked = {"environment": environment, "model": model, "albedo": True, "bounces": True}
    asked |= {**switches, "pixels": pixels.tolist()}
    found = page.run(f"const asked = {json.dumps(asked)}; {SEE}")
    return map(np.array, found)


def nearly_baked_light(scene):
    """A light that has turned a little since the bake, so that all terms show."""
    rng = np.random.default_rng(3)
    baked = rng.normal(0, 0.3, (25, 3))
    baked[:4] += [[3], [0.3], [2], [0.5]]
    now = baked + 0.03 * rng.normal(size=(25, 3))
    peaks = light_state.read(scene).peaks
    peaks = tuple(replace(p, irradiance=tuple(np.array(p.irradiance) / 15)) for p in peaks)
    light_state.write(scene, light_state.LightState("key", baked, now, baked, peaks=peaks))


def painted(obj, colour=(0.8, 0.3, 0.1, 1)):
    material = bpy.data.materials.new("Painted")
    if bpy.app.version < (5, 0):
        material.use_nodes = True
    shader = next(n for n in material.node_tree.nodes if n.type == "BSDF_PRINCIPLED")
    shader.inputs["Base Color"].default_value = colour
    obj.data.materials.append(material)
    return obj


def by_hand(bake):
    """Corners and a residual on a mirrored mesh; orders of their own beside each other."""
    first, second = painted(mirrored()), rotated()
    second.location.x += 3
    bake(first, order=5, turns=1, lights=2, domain="CORNER", smooth=True)
    bake(second, order=2, turns=1, smooth=True)
    return [first, second]


def modified(bake):
    first = painted(monkey("First"))
    first.modifiers.new("Subdivision", "SUBSURF")
    second = first.copy()
    second.name, second.location = "Second", (3, 0, 0)
    bpy.context.scene.collection.objects.link(second)
    for obj in (first, second):
        bake(obj, turns=12, by_modifier=True, smooth=True)
    return [first, second]


def many(bake):
    obj = sheared()
    bake(obj, order=4, channels=3, turns=1, smooth=True)
    return [obj]


def short(bake):
    bpy.context.scene.prt.gltf_short = True
    obj = painted(rotated())
    bake(obj, turns=1, lights=1, smooth=True)
    return [obj]


def real(bake):
    """By the engine, under a real HDRI with its sun cut out."""
    hdri(bpy.context.scene, "sunset")
    bpy.ops.mesh.primitive_grid_add(
        x_subdivisions=20, y_subdivisions=20, size=6, location=(0, 0, -1)
    )
    objects = [painted(bpy.context.object), monkey()]
    settings = Settings(rays=32, peaks=1, residual=True)
    for _ in baking.bake(bpy.context.scene.name, [obj.name for obj in objects], settings):
        pass
    return objects


def textured(bake):
    """An atlas of two objects, one of them through modifiers, and one of three channels at the
    highest order."""
    first, second, third = painted(mirrored()), monkey("Second"), sheared()
    second.modifiers.new("Subdivision", "SUBSURF")
    second.location, third.location = (3, 0, 0), (-3, 1, 0)
    third.data.materials.append(bpy.data.materials.new("Own"))
    for shared in (first, second):
        shared.data.materials.clear()
        shared.data.materials.append(bpy.data.materials.get("Painted"))
    bpy.context.view_layer.update()
    folder = Path(bpy.app.tempdir)
    bake_in_texture(folder, [first, second], Layout(3, turns=12, lights=2), size=128)
    bake_in_texture(folder, [third], Layout(5, channels=3, turns=1))
    return [first, second, third]


SCENES = {f.__name__.replace("_", " "): f for f in (by_hand, modified, many, short, textured, real)}


@pytest.mark.parametrize("make", SCENES.values(), ids=SCENES)
@pytest.mark.usefixtures("registered")
def test_pixels_are_those_of_the_blend_standing_and_turned(scene, bake, page, tmp_path, make):
    out = tmp_path / "scene.glb"
    nearly_baked_light(scene)
    objects = make(bake)
    bpy.context.view_layer.update()
    gltf_export.write(str(out))
    camera = page.run(OPEN, glb=out)
    assert camera["problems"] == []
    assert camera["baked"] == len(objects)
    for environment, model in ((0, 0), (77, 0), (0, 40), (77, 40)):
        pixels, truth = expected(objects, camera, environment, model)
        floats, bytes8 = see(page, pixels, environment, model)
        assert len(pixels) > 40
        assert (truth > 0.05).mean() > 0.3
        np.testing.assert_allclose(floats, truth, rtol=1e-3, atol=1e-3)
        assert np.abs(bytes8 - encoded(truth)).max() <= 1


@pytest.mark.parametrize("in_short", [False, True])
def test_an_open_white_surface_under_a_white_sky_is_white(registered, scene, out, page, in_short):
    colour(scene, (1, 1, 1))
    bpy.ops.mesh.primitive_ico_sphere_add(subdivisions=3)
    obj = bpy.context.object
    for _ in baking.bake(scene.name, [obj.name], Settings(rays=64)):
        pass
    scene.prt.gltf_short = in_short
    gltf_export.write(str(out))
    camera = page.run(OPEN, glb=out)
    for environment, model in ((0, 0), (77, 40)):
        pixels, _ = expected([obj], camera, environment, model)
        assert len(pixels) > 100
        floats, _ = see(page, pixels, environment, model, albedo=False)
        np.testing.assert_allclose(floats, 1, atol=1e-4)


def test_of_metal_the_diffuse_part_is_baked(scene, bake, page, out):
    """Half a metal in a dark room of three.js' own shows half of what a dielectric does."""
    nearly_baked_light(scene)
    obj = painted(monkey())
    bake(obj, turns=1, smooth=True)
    shader = next(n for n in obj.data.materials[0].node_tree.nodes if n.type == "BSDF_PRINCIPLED")
    found = []
    for metallic in (0.0, 0.5):
        shader.inputs["Metallic"].default_value = metallic
        gltf_export.write(str(out))
        camera = page.run(OPEN, glb=out)
        page.run("viewer.stage.scene.environment = null;")
        pixels, truth = expected([obj], camera)
        floats, _ = see(page, pixels)
        found.append(floats / (1 - metallic))
    assert truth.max() > 0.1
    np.testing.assert_allclose(found[0], truth, rtol=1e-3, atol=1e-3)
    np.testing.assert_allclose(found[1], found[0], rtol=1e-3, atol=1e-3)
