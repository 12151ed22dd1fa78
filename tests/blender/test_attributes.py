"""Baked values lie on the mesh exactly, and nothing else of the mesh changes."""

import numpy as np
import pytest
import snapshot
from bakes import quad, random_bake, write
from prt_baker.addon import attributes, remove, writeback
from prt_baker.addon.prt.errors import BakeError
from prt_baker.addon.prt.layout import Layout

LAYOUTS = [Layout(2), Layout(4, 3), Layout(3, turns=1), Layout(2, turns=3, lights=2)]
LAYOUTS += [Layout(3, turns=1, visibility_order=3), Layout(2, 3, 1, 1, 2)]


@pytest.mark.parametrize("domain", ["POINT", "CORNER"])
@pytest.mark.parametrize("layout", LAYOUTS)
def test_what_is_written_reads_back_equal(scene, layout, domain):
    obj = quad(scene)
    [(_, result, stamp)] = write(scene, layout, obj, domain=domain)
    held = attributes.read(obj, stamp)
    np.testing.assert_array_equal(held.transfer, result.transfer)
    np.testing.assert_array_equal(held.residual, result.residual)
    np.testing.assert_array_equal(held.visibility, result.visibility)
    np.testing.assert_array_equal(held.visibility_sh, result.visibility_sh)


def test_a_second_bake_replaces_the_first(scene):
    obj = quad(scene)
    write(scene, Layout(5), obj)
    [(_, result, stamp)] = write(scene, Layout(2), obj, domain="CORNER")
    assert attributes.names(obj.data) == ["_PRT_0"]
    np.testing.assert_array_equal(attributes.read(obj, stamp).transfer, result.transfer)


@pytest.mark.parametrize("colours", [(), ("First",), ("First", "Second")])
def test_the_active_attributes_stay_active(scene, colours):
    obj = quad(scene)
    for name in colours:
        obj.data.color_attributes.new(name, "FLOAT_COLOR", "POINT")
    if colours:
        obj.data.attributes.active_color_name = colours[0]
        obj.data.attributes.default_color_name = colours[-1]
    state = snapshot.of(scene)["meshes"]["Quad"]
    write(scene, Layout(3), obj)
    baked = snapshot.of(scene)["meshes"]["Quad"]
    assert (baked["active"], baked["colours"]) == (state["active"], state["colours"])
    remove.remove(scene, [obj])
    assert snapshot.of(scene)["meshes"]["Quad"] == state


def test_elements_that_were_not_traced_are_black(scene):
    obj, result, stamp = random_bake(quad(scene), Layout(3))
    result.element_points[1] = -1
    writeback.write(scene, [(obj, result, stamp)], Layout(3))
    values = attributes.read(obj, stamp).transfer
    assert not values[1].any()
    np.testing.assert_array_equal(values[2], result.transfer[2])


def test_lost_attributes_are_told(scene):
    obj = quad(scene)
    [(_, _, stamp)] = write(scene, Layout(3), obj)
    obj.data.attributes.remove(obj.data.attributes["_PRT_1"])
    with pytest.raises(BakeError, match="'Quad' are gone: bake it again"):
        attributes.read(obj, stamp)
