"""Residuals from the engine to the picture: shown as far as they belong to the world of now."""

from dataclasses import replace
from math import pi

import bpy
import numpy as np
import pytest
from bakes import principled, quad
from pictures import colour, look_down, render
from prt_baker.addon import attributes, bake, engine, light_state, stamp, writeback
from prt_baker.addon.prt import job as jobs
from prt_baker.addon.prt.errors import BakeError
from prt_baker.addon.prt.job import Peak, Settings
from prt_baker.addon.prt.layout import Layout
from prt_baker.addon.prt.light import projection, residual
from prt_baker.addon.prt.results import ReceiverResult, Results
from prt_baker.addon.prt.steps import value_of
from worlds import environment, generated, new_world, picture

PEAK = Peak((0.6, 0.0, 0.8), (0.3, 0.2, 0.1), 0.05)
STRENGTH = 0.3
VIEW = 1


def as_strong_as(source):
    """The peak of a world whose strength is not 0.3."""
    factor = source.strength[0] / STRENGTH
    return replace(PEAK, irradiance=tuple(factor * value for value in PEAK.irradiance))


class Engine:
    """Made-up results in the engine's place; ``jobs`` are those that it was given."""

    def __init__(self):
        self.jobs = []

    def __call__(self, job, _folder):
        yield jobs.Progress("transfer", 0.5)
        self.jobs.append(job)
        image_sh = projection.project(job.light).image_sh if job.light else None
        measured = {"on_surface": 0.03, "at_points": 0.01, "light_on_surface": 0.02}
        entries = [
            {"name": receiver.name, "points": 4, "mrays_per_second": 1.0, "rays_per_point": 77.6}
            | {"estimated_error": 0.01, "interpolation_error": 0.02, "measured_error": None}
            for receiver in job.receivers
        ]
        for entry in entries if job.kind == "verify" else ():
            entry["measured_error"] = measured
        report = {"objects": entries, "light": {"projection": "lat-long"}, "job_hash": "made up"}
        report["settings"] = {"rays": job.settings.rays}
        receivers = [self._bake(receiver, job.settings) for receiver in job.receivers]
        peaks = (as_strong_as(job.light),) if job.light and job.settings.peaks else ()
        return Results(image_sh, tuple(receivers) if job.kind == "bake" else (), report, peaks)

    def _bake(self, receiver, settings):
        count = len(receiver.vertices if receiver.domain == "POINT" else receiver.corner_vertices)
        rng = np.random.default_rng(len(receiver.name))
        transfer = rng.normal(0, 0.05, (count, 1, settings.order**2))
        transfer[:, 0, 0] = rng.uniform(0.2, 0.3, count)
        turns = settings.turns if settings.residual else 0
        return ReceiverResult(
            receiver.name,
            transfer.astype(np.float32),
            np.arange(count, dtype=np.int32),
            rng.normal(0, 0.1, (count, turns, 3)).astype(np.float32),
            rng.uniform(0.2, 1, (count, min(1, settings.peaks))).astype(np.float32),
        )


@pytest.fixture
def made_up(monkeypatch):
    found = Engine()
    monkeypatch.setattr(engine, "run", found)
    return found


@pytest.fixture
def world(scene):
    """The nodes of a world above one square, which is seen from above."""
    nodes = environment(scene, generated(picture()), STRENGTH, rotation=(0, 0, 0))
    quad(scene, material=principled(Base_Color=(1, 1, 1, 1)), name="Floor")
    look_down(scene, VIEW, VIEW)
    bpy.context.view_layer.update()
    return nodes


def baked(scene, *names, **settings):
    return value_of(bake.bake(scene.name, list(names), Settings(**settings)))


def turn(nodes, degrees):
    nodes["mapping"].inputs["Rotation"].default_value[2] = -np.radians(degrees)
    bpy.context.view_layer.update()


def strengthen(nodes, factor):
    nodes["background"].inputs["Strength"].default_value *= factor
    bpy.context.view_layer.update()


def values(name):
    obj = bpy.data.objects[name]
    return attributes.read(obj, stamp.read(obj))


def held(node):
    """What the one group holds in ``node``."""
    [tree] = [tree for tree in bpy.data.node_groups if tree.name.startswith("PRT Shading")]
    return np.array(tree.nodes[node].inputs[1].default_value)


def at_centre(per_vertex):
    """The mean (3,) of the four pixels about the middle, by Blender's two triangles."""
    places = np.array([[4, 5], [5, 4], [4, 4], [5, 5]]) / 10 + 0.05
    shown = []
    for x, y in places:
        corners = (0, 1, 2) if x >= y else (0, 2, 3)
        u, v = (x - y, y) if x >= y else (x, y - x)
        shown.append(np.array([1 - u - v, u, v]) @ per_vertex[list(corners)])
    return np.mean(shown, axis=0)


def seen(scene, folder):
    return colour(render(scene, folder), "Combined")[4:6, 4:6].mean(axis=(0, 1))


def exact(scene, name, weights, lamp):
    """Exit radiance (E, 3) with known ``weights`` (turns, 3) and ``lamp`` (3) of the peak."""
    stored, now = values(name), light_state.read(scene).radiance_sh
    coefficients = now - lamp * residual.peaks_sh((PEAK,))
    total = stored.transfer[:, 0] @ coefficients[:9]
    total += np.einsum("ekc,kc->ec", stored.residual, weights)
    return total + stored.visibility * (lamp * np.array(PEAK.irradiance) / pi)


def test_eevee_shows_the_residual_where_the_world_is_the_baked_one(scene, world, made_up, tmp_path):
    baked(scene, "Floor", turns=4, peaks=1)
    assert stamp.read(bpy.data.objects["Floor"]).packing == Layout(3, 1, 4, 1)
    one = np.eye(4)[:, :, None] * np.ones(3)
    cases = [
        (lambda: None, one[0], 1.0),
        (lambda: strengthen(world, 2), 2 * one[0], 2.0),
        (lambda: turn(world, 90), 2 * one[1], 0.0),
        (lambda: turn(world, 345), one[3] / 3 + 5 / 3 * one[0], 5 / 3),
    ]
    for change, weights, lamp in cases:
        change()
        truth = at_centre(exact(scene, "Floor", weights, lamp))
        np.testing.assert_allclose(seen(scene, tmp_path), truth, rtol=3e-3)


def test_a_swapped_world_is_shown_without_the_residual(scene, world, made_up):
    baked(scene, "Floor", peaks=1)
    np.testing.assert_allclose(held("R0"), 1, rtol=1e-6)
    new_world(scene).nodes["Background"].inputs["Color"].default_value = (1, 0.5, 0.2, 1)
    bpy.context.view_layer.update()
    np.testing.assert_array_equal(held("R0"), 0)
    np.testing.assert_array_equal(held("S0"), 0)
    np.testing.assert_array_equal(held("P0"), 0)


def test_turning_fades_it_and_turning_back_brings_it_back(scene, world, made_up):
    baked(scene, "Floor")
    shown = []
    for degrees in (0, 5, 20, 90, 0):
        turn(world, degrees)
        state = light_state.read(scene)
        expected = residual.weight(state.radiance_sh, state.baked_radiance_sh)
        np.testing.assert_allclose(held("R0"), expected, rtol=1e-6)
        shown.append(held("R0")[0])
    assert shown[0] == shown[-1] == pytest.approx(1)
    assert sorted(shown[:4], reverse=True) == shown[:4]
    assert shown[1] < 0.99
    assert shown[3] < 0.1


def test_a_colour_asks_for_no_residual_and_no_peaks(scene, world, made_up):
    new_world(scene)
    baked(scene, "Floor", peaks=4)
    settings = made_up.jobs[0].settings
    assert (settings.residual, settings.peaks) == (False, 0)
    assert stamp.read(bpy.data.objects["Floor"]).packing == Layout(3)


def test_what_was_baked_under_a_weaker_light_keeps_its_residual(scene, world, made_up, tmp_path):
    second(scene, own_material=False)
    baked(scene, "Floor", peaks=1)
    strengthen(world, 2)
    notes = baked(scene, "Second", peaks=1)["notes"]
    assert notes == []
    assert stamp.share(bpy.data.objects["Floor"]) == pytest.approx(2)
    assert stamp.share(bpy.data.objects["Second"]) == 1
    truth = at_centre(exact(scene, "Floor", 2 * np.ones((1, 3)), 2))
    np.testing.assert_allclose(seen(scene, tmp_path), truth, rtol=3e-3)


def second(scene, own_material):
    """Another square, with its own material or with the first one's."""
    material = principled() if own_material else bpy.data.objects["Floor"].data.materials[0]
    return quad(scene, 2, 0, material, "Second")


@pytest.mark.parametrize("own_material", [True, False])
def test_what_was_baked_under_another_light_is_shown_without_it(
    scene, world, made_up, tmp_path, own_material
):
    second(scene, own_material)
    baked(scene, "Floor", peaks=1)
    turn(world, 30)
    notes = baked(scene, "Second", peaks=1)["notes"]
    assert len(notes) == 1
    assert "'Floor' was baked under another world" in notes[0]
    plain = values("Floor").transfer[:, 0] @ light_state.read(scene).radiance_sh[:9]
    np.testing.assert_allclose(seen(scene, tmp_path), at_centre(plain), rtol=3e-3)
    assert baked(scene, "Second", peaks=1)["notes"] == [], "it is said once"
    baked(scene, "Floor", "Second", peaks=1)
    assert stamp.share(bpy.data.objects["Floor"]) == 1


def test_the_same_world_read_again_changes_no_share(scene, world, made_up):
    second(scene, own_material=True)
    baked(scene, "Floor")
    baked(scene, "Second")
    assert stamp.share(bpy.data.objects["Floor"]) == pytest.approx(1)


def test_verify_is_given_all_that_is_shown_and_the_light(scene, world, made_up):
    baked(scene, "Floor", peaks=1)
    strengthen(world, 3)
    value_of(bake.verify(scene.name, ["Floor"], Settings(verify_points=4)))
    job = made_up.jobs[-1]
    assert job.kind == "verify"
    assert job.light.strength == pytest.approx((0.9,) * 3)
    [receiver] = job.receivers
    stored = values("Floor")
    np.testing.assert_array_equal(receiver.transfer, stored.transfer)
    shown = exact(scene, "Floor", np.full((1, 3), 3), 3)
    plain = stored.transfer[:, 0] @ light_state.read(scene).radiance_sh[:9]
    np.testing.assert_allclose(receiver.residual[:, 0], shown - plain, atol=1e-5)
    mark = stamp.read(bpy.data.objects["Floor"])
    assert (mark.measured_error, mark.measured_at_points, mark.light_error) == (0.03, 0.01, 0.02)
    assert not mark.light_at_bake
    strengthen(world, 1 / 3)
    value_of(bake.verify(scene.name, ["Floor"], Settings(verify_points=4)))
    assert stamp.read(bpy.data.objects["Floor"]).light_at_bake


def test_without_a_world_the_transfer_is_verified_still(scene, world, made_up):
    baked(scene, "Floor")
    scene.world = None
    value_of(bake.verify(scene.name, ["Floor"], Settings(verify_points=4)))
    assert made_up.jobs[-1].light is None


def test_the_stamp_says_what_the_order_leaves_out(scene, world, made_up):
    baked(scene, "Floor")
    stored, state = values("Floor"), light_state.read(scene)
    whole = stored.transfer[:, 0] @ state.radiance_sh[:9] + stored.residual[:, 0]
    expected = np.sqrt((stored.residual**2).sum() / (whole**2).sum())
    mark = stamp.read(bpy.data.objects["Floor"])
    assert mark.plain_error == pytest.approx(expected, rel=1e-4)
    assert (mark.estimated_error, mark.interpolation_error, mark.rays) == (0.01, 0.02, 78)
    baked(scene, "Floor", residual=False)
    assert stamp.read(bpy.data.objects["Floor"]).plain_error is None


def test_what_eevee_cannot_read_is_refused_before_a_ray(scene, world, made_up):
    with pytest.raises(BakeError, match=r"order 3 with 24 turns takes 21 .* or fewer turns"):
        baked(scene, "Floor", turns=24)
    assert made_up.jobs == []


def test_fewer_peaks_than_were_allowed_beside_a_bake_with_as_many(scene, world, made_up):
    second(scene, own_material=False)
    baked(scene, "Floor", peaks=4)
    assert stamp.read(bpy.data.objects["Floor"]).packing.lights == 1
    baked(scene, "Second", peaks=4)
    with pytest.raises(BakeError, match="'Floor' was baked with order 3 with 1 peak and shares"):
        baked(scene, "Second", peaks=4, residual=False)


def test_updating_the_light_keeps_the_baked_one(scene, world, made_up):
    baked(scene, "Floor", peaks=1)
    before = light_state.read(scene)
    turn(world, 40)
    value_of(bake.update_light(scene.name))
    after = light_state.read(scene)
    np.testing.assert_array_equal(after.baked_radiance_sh, before.baked_radiance_sh)
    assert after.peaks == before.peaks != ()
    assert not writeback.set_light(after)


@pytest.mark.parametrize("factor", [1.0, 2.5])
def test_lights_agree_by_strength_alone(factor):
    def state(coefficients, peaks=(PEAK,)):
        return light_state.LightState("", coefficients, coefficients, coefficients, peaks=peaks)

    first = np.random.default_rng(0).normal(size=(25, 3))
    stronger = replace(PEAK, irradiance=tuple(factor * np.array(PEAK.irradiance)))
    other = state(factor * first, (stronger,))
    assert light_state.share(state(first), other, True) == pytest.approx(factor)
    tinted = state(factor * first * (1, 1, 1.01), (stronger,))
    assert light_state.share(state(first), tinted, False) == 0
    without = state(factor * first, ())
    assert light_state.share(state(first), without, True) == 0
    assert light_state.share(state(first), without, False) == pytest.approx(factor)
    moved = state(factor * first, (replace(stronger, direction=(0, 0, 1)),))
    assert light_state.share(state(first), moved, True) == 0
    black = state(0 * first)
    assert light_state.share(state(first), black, False) == 0
    assert light_state.share(black, state(first), False) == 0


def test_stamps_and_lights_of_the_first_release_are_read(scene):
    obj = quad(scene)
    obj[stamp.KEY] = OLD_STAMP
    found = stamp.read(obj)
    assert found.packing == Layout(2)
    assert (stamp.share(obj), found.plain_error) == (0, None)
    obj[stamp.KEY] = OLD_STAMP.replace('"version": 1', f'"version": {stamp.VERSION + 1}')
    assert stamp.read(obj) is None
    zeros = np.zeros((25, 3)).tolist()
    names = ("image_sh", "radiance_sh", "baked_radiance_sh")
    old = {"image_key": "", "follows": True, **dict.fromkeys(names, zeros)}
    scene[light_state.KEY] = str(old).replace("'", '"').replace("True", "true")
    assert light_state.read(scene).peaks == ()


OLD_STAMP = (
    '{"order": 2, "channels": 1, "layout": ["T0", "T1", "T2", "T3"], "carrier": "vertex", '
    '"domain": "POINT", "by_modifier": false, "job_hash": "", "mesh_signature": "", '
    '"matrix": [1, 0, 0, 0, 1, 0, 0, 0, 1], "location": [0, 0, 0], "points": 4, "rays": 256, '
    '"mrays_per_second": 1.0, "estimated_error": 0.01, "measured_error": null, "version": 1}'
)
