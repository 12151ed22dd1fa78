"""Bakes as 16-bit numbers: half the size, and as far off as docs/gltf.md says."""

import bpy
import io_scene_gltf2
import numpy as np
import pytest
from glb import Glb
from gltf_laws import light_of
from gltf_scenes import BAKED, COLORS, colored, monkey, rotated
from gltf_validator import assert_valid
from prt_baker.addon import gltf_attributes, gltf_export, gltf_panel

STEP = 1 / 65534  # of a float's scale: the largest error
ROUNDING = STEP * 0.02  # of float32: two products


@pytest.fixture
def both(registered, scene, out):
    """Write the file with floats and with 16-bit numbers; both, read."""

    def write():
        files = []
        for short in (False, True):
            with gltf_panel.chosen(scene, short):
                gltf_export.write(str(out))
            assert_valid(out)
            files.append(Glb(out))
        assert not scene.prt.gltf_short
        return files

    return write


def all_slots(glb, name):
    """Every float of the node ``name`` as a reader has it, (E, 4 k)."""
    layout = [slot for slot in glb.prt(name)["layout"] if slot]
    return glb.slots(name, layout)


def scale_of(glb, name):
    prt = glb.prt(name)
    return np.array([s for s, slot in zip(prt["scale"], prt["layout"], strict=True) if slot])


@pytest.mark.parametrize("make", BAKED.values(), ids=BAKED)
def test_every_float_is_within_the_stated_error(scene, bake, both, make):
    make(bake)
    exact, short = both()
    names = [node["name"] for node in exact.document["nodes"] if "mesh" in node]
    baked = [name for name in names if exact.prt(name)]
    assert baked
    for name in baked:
        found, truth = all_slots(short, name), all_slots(exact, name)
        scale = scale_of(short, name)
        np.testing.assert_array_equal(scale, np.abs(truth).max(axis=0))
        assert (np.abs(found - truth) <= scale * (STEP + ROUNDING)).all()
        assert (np.abs(found - truth).max(axis=0) > 0.5 * STEP * scale).any(), "not quantized"


def test_the_bake_takes_half_the_bytes(scene, bake, both):
    obj = monkey()
    bake(obj, turns=1)
    exact, short = both()

    def size(glb):
        attributes = glb.mesh(obj.name)["primitives"][0]["attributes"]
        accessors = [glb.document["accessors"][a] for n, a in attributes.items() if "_PRT" in n]
        assert len(accessors) == 3
        views = [glb.document["bufferViews"][a["bufferView"]] for a in accessors]
        return sum(view["byteLength"] for view in views)

    assert size(exact) == 2 * size(short)


def test_the_light_is_within_the_stated_error(scene, bake, both):
    """Exit radiance is off by at most Σ scale_i |L_i| / 65534."""
    obj = rotated()
    bake(obj)
    exact, short = both()
    light = light_of(exact, 3)
    bound = STEP * np.array(short.prt(obj.name)["scale"])[:9] @ np.abs(light)
    difference = (short.transfer(obj.name) - exact.transfer(obj.name)) @ light
    assert np.abs(difference).max() > 0
    assert (np.abs(difference) <= bound * 1.02).all()


def test_the_primitives_of_a_mesh_share_one_scale(scene, bake, both):
    obj = colored(COLORS, "Dirt")
    bake(obj, turns=1)
    exact, short = both()
    assert len(short.mesh(obj.name)["primitives"]) == 2
    scale = scale_of(short, obj.name)
    np.testing.assert_array_equal(scale, np.abs(all_slots(exact, obj.name)).max(axis=0))


def test_a_float_that_is_zero_everywhere_stays_zero():
    values = np.array([[0, 1e-30, -3, 7]], np.float32)
    scale = gltf_attributes.scale_of([values, -2 * values])
    np.testing.assert_array_equal(scale, np.float32([0, 2e-30, 6, 14]))
    short = gltf_attributes.quantized(-2 * values, scale)
    np.testing.assert_array_equal(short, [[0, -32767, 32767, -32767]])


class Noting:
    """A layout that notes what is shown in it."""

    def __init__(self):
        self.shown = []

    def panel(self, idname, default_closed):
        return self, self

    def row(self):
        return self

    def label(self, text):
        self.shown.append(text)

    def prop(self, owner, name):
        assert hasattr(owner, name)
        self.shown.append(name)


def test_it_is_chosen_in_a_panel_of_the_exporter(registered, scene):
    layout = Noting()
    io_scene_gltf2.export_panel_user_extension(bpy.context, layout)
    assert layout.shown == ["PRT Baker", "gltf_short", "gltf_compress", "gltf_error", "gltf_ibl"]


def test_no_panel_is_left_behind(registered):
    gltf_panel.unregister()
    assert "PRT Baker" not in io_scene_gltf2.exporter_extension_layout_draw
    gltf_panel.register()
