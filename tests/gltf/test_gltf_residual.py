"""Residuals and lights cut out arrive in a .glb as they are in the .blend."""

import bpy
import numpy as np
import pytest
from glb import Glb
from gltf_laws import TURN, Y_UP, element_values, light_of
from gltf_scenes import NODES, mirrored, monkey
from gltf_validator import assert_valid
from prt_baker.addon import attributes, gltf_export, light_state, stamp
from prt_baker.addon.prt import sh

RGB = (1, 2, 3)  # how the residuals made by hand differ in their channels


def written(out, obj):
    gltf_export.write(str(out), [obj.name])
    return Glb(out)


def light_extras(glb):
    return glb.document["scenes"][0]["extras"]["prt_light"]


@pytest.mark.parametrize("make", NODES)
@pytest.mark.parametrize("domain", ["POINT", "CORNER"])
def test_they_are_numbers_that_no_turn_of_the_frame_changes(scene, bake, out, make, domain):
    obj = make()
    bake(obj, turns=2, lights=2, domain=domain)
    glb = written(out, obj)
    first = glb.slots(obj.name, ["T0"])
    for k in range(2):
        found = glb.slots(obj.name, [f"R{k}{c}" for c in "rgb"])
        np.testing.assert_array_equal(found, ((k + 1) * first * RGB).astype(np.float32))
        np.testing.assert_array_equal(glb.slots(obj.name, [f"S{k}"]), first / np.float32(k + 2))


def test_what_is_seen_is_turned_with_the_frame(scene, bake, out):
    """What a direction sees is the same in the file."""
    obj = monkey()
    bake(obj, seen=3)
    glb = written(out, obj)
    held = attributes.read(obj, stamp.read(obj))
    first, found = (
        glb.slots(obj.name, ["T0"])[:, 0],
        glb.slots(obj.name, [f"V{i}" for i in range(9)]),
    )
    here = held.transfer[:, 0, 0]
    order = np.argsort(here)
    expected = held.visibility_sh[order[np.searchsorted(here[order], first)]]
    directions = np.random.default_rng(0).normal(size=(20, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    x, y, z = directions.T
    seen = found @ sh.basis(np.stack([x, z, -y], axis=1), 3).T
    np.testing.assert_allclose(seen, expected @ sh.basis(directions, 3).T, atol=1e-5)
    assert_valid(out)


def test_turns_are_told_where_there_are_several(scene, bake, out):
    obj = monkey()
    bake(obj, turns=12)
    glb = written(out, obj)
    assert glb.prt(obj.name)["turns"] == 12
    assert glb.prt(obj.name)["layout"][9:] == [f"R{k}{c}" for k in range(12) for c in "rgb"] + [
        "" for _ in range(3)
    ]
    assert_valid(out)


def test_lights_point_to_where_they_are_in_the_frame_of_gltf(scene, bake, out):
    obj = monkey()
    bake(obj, turns=1, lights=2)
    found = light_extras(written(out, obj))["lights"]
    for light, peak in zip(found, light_state.read(scene).peaks, strict=True):
        x, y, z = peak.direction
        np.testing.assert_allclose(light["direction"], (x, z, -y), atol=1e-12)
        assert tuple(light["irradiance"]) == peak.irradiance
        assert light["angular_radius"] == peak.angular_radius
    assert_valid(out)


def disc(light):
    """Coefficients (25, 3) of one of the file's lights, by the formula of docs/gltf.md."""
    x = np.cos(light["angular_radius"])
    slopes = 1, 3 * x, (15 * x**2 - 3) / 2, (35 * x**3 - 15 * x) / 2
    zonal = [2 / (1 + x)] + [2 * s / (l * (l + 1)) for l, s in enumerate(slopes, 1)]  # noqa: E741
    values = sh.basis(light["direction"], 5) * np.repeat(zonal, (1, 3, 5, 7, 9))
    return np.outer(values, light["irradiance"])


def seen(glb, name, delta):
    """Exit radiance (E, 3) that a reader of the file shows of a node turned by ``delta``, by the
    formula of docs/gltf.md for one residual."""
    extras = light_extras(glb)
    now, baked = np.array(extras["radiance_sh"]), np.array(extras["baked_radiance_sh"])
    now = sh.rotate(now, delta.T)
    a, b = now[1:9].ravel(), baked[1:9].ravel()
    rho = a @ b / np.linalg.norm(a) / np.linalg.norm(b)
    weight = np.linalg.norm(now, axis=0) / np.linalg.norm(baked, axis=0) * max(0, rho) ** 16
    coefficients = now - weight * sum(map(disc, extras["lights"]))
    total = glb.transfer(name)[:, 0] @ coefficients[:9]
    total = total + weight * glb.slots(name, ["R0r", "R0g", "R0b"])
    for j, light in enumerate(extras["lights"]):
        lamp = weight * np.array(light["irradiance"]) / np.pi
        total = total + glb.slots(name, [f"S{j}"]) * lamp
    return total


@pytest.mark.parametrize("turn", [np.eye(3), TURN], ids=["standing", "turned"])
def test_a_reader_shows_what_the_blend_shows(scene, bake, out, turn):
    """A viewer that turns the model turns the light the other way, and so weighs the residual."""
    obj = mirrored()
    transfer = bake(obj, turns=1, lights=2)
    state = light_state.read(scene)
    rng = np.random.default_rng(1)
    baked = state.baked_radiance_sh + 8 * np.eye(25)[:, 2:3]
    now = baked + 0.05 * rng.normal(size=(25, 3))
    state = light_state.LightState("key", baked, now, baked, peaks=state.peaks)
    light_state.write(scene, state)
    glb = written(out, obj)
    _, stored = element_values(glb, obj.name, transfer)
    turned = light_state.LightState("key", baked, sh.rotate(now, turn.T), baked, peaks=state.peaks)
    terms = light_state.terms(turned, stamp.read(obj).packing)
    first = stored[:, 0, :1].astype(np.float64)
    truth = stored[:, 0] @ (turned.radiance_sh - terms.cut_out)[:9]
    truth += first * RGB * terms.residual[0] + first / [2, 3] @ terms.lights
    assert terms.residual.max() > 0.02
    np.testing.assert_allclose(
        seen(glb, obj.name, Y_UP @ turn @ Y_UP.T), truth, rtol=1e-4, atol=1e-4
    )


def test_what_belongs_to_another_light_is_left_out(scene, bake, out):
    obj = monkey()
    transfer = bake(obj, turns=1, lights=2)
    stamp.set_share(obj, 0.0)
    glb = written(out, obj)
    assert [name for name in glb.prt(obj.name)["layout"] if name] == [f"T{i}" for i in range(9)]
    assert set(glb.attributes(obj.name)[0]) >= {"_PRT_0", "_PRT_1", "_PRT_2"}
    assert "_PRT_3" not in glb.attributes(obj.name)[0]
    found, expected = element_values(glb, obj.name, transfer)
    np.testing.assert_allclose(found @ light_of(glb, 3), expected @ blend_light(), atol=1e-5)
    assert_valid(out)


def blend_light():
    return light_state.read(bpy.context.scene).radiance_sh[:9]


def test_what_belongs_to_a_weaker_light_is_scaled_to_the_files(scene, bake, out):
    obj = monkey()
    bake(obj, turns=1)
    stamp.set_share(obj, 2.0)
    glb = written(out, obj)
    first = glb.slots(obj.name, ["T0"])
    found = glb.slots(obj.name, ["R0r", "R0g", "R0b"])
    np.testing.assert_array_equal(found, (2 * first * RGB).astype(np.float32))
