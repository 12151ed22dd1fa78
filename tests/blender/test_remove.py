"""Remove Bake, and a write that fails, leave the file as it was."""

import bpy
import numpy as np
import pytest
import snapshot
from bakes import place, principled, quad, random_bake, write
from prt_baker.addon import attributes, light_state, materials, remove, writeback
from prt_baker.addon.prt.errors import BakeError
from prt_baker.addon.prt.layout import Layout
from prt_baker.addon.prt.results import ReceiverResult

LAYOUT = Layout(3)


def scenery(scene):
    """One object of each kind that a bake treats in its own way."""
    plain = quad(scene, 0, 0, principled())
    bare = quad(scene, 2, 0, name="Bare")
    bent = quad(scene, 4, 0, name="Bent")
    bent.modifiers.new("Array", "ARRAY")
    twins = [quad(scene, 6, 0, name="Twin")]
    twins.append(place(scene, twins[0].data, 8, 0))
    empty = quad(scene, 10, 0, name="Empty Slots")
    for _ in range(2):
        empty.data.materials.append(None)
    hidden = bpy.data.materials.new("Hidden")
    empty.material_slots[1].link = "OBJECT"
    empty.material_slots[1].material = hidden
    empty.material_slots[1].link = "DATA"
    empty.data.color_attributes.new("Colour", "BYTE_COLOR", "CORNER")
    bpy.context.view_layer.update()
    return [plain, bare, bent, *twins, empty]


def test_the_file_is_what_it_was(scene):
    objects = scenery(scene)
    state = snapshot.of(scene)
    write(scene, LAYOUT, *objects)
    write(scene, Layout(4, 3), *objects, domain="CORNER")
    assert snapshot.of(scene) != state
    assert remove.remove(scene, objects) == len(objects)
    assert snapshot.of(scene) == state
    slot = bpy.data.objects["Empty Slots"].material_slots[1]
    slot.link = "OBJECT"
    assert slot.material.name == "Hidden"


def test_one_after_the_other_in_any_order(scene):
    objects = scenery(scene)
    state = snapshot.of(scene)
    write(scene, LAYOUT, *objects)
    for obj in reversed(objects):
        assert remove.remove(scene, [obj]) == 1
    assert snapshot.of(scene) == state


def test_what_others_still_need_stays(scene):
    material = principled()
    first, second = quad(scene, 0, 0, material), quad(scene, 2, 0, material)
    write(scene, LAYOUT, first, second)
    light_state.write(scene, light_state.LightState("", *[np.zeros((25, 3))] * 3))
    remove.remove(scene, [first])
    assert materials.attached() == [material]
    assert attributes.names(second.data)
    assert light_state.read(scene)
    remove.remove(scene, [second])
    assert not materials.attached()
    assert light_state.read(scene) is None


def test_what_was_never_baked_is_not_touched(scene):
    obj = quad(scene)
    state = snapshot.of(scene)
    assert remove.remove(scene, [obj]) == 0
    assert snapshot.of(scene) == state


def test_after_a_baked_object_was_deleted_its_material_is_freed(scene):
    material = principled()
    first, second = quad(scene, 0, 0, material), quad(scene, 2, 0, principled("Other"))
    write(scene, LAYOUT, first, second)
    bpy.data.objects.remove(first)
    remove.remove(scene, [second])
    assert not materials.attached()
    assert not bpy.data.node_groups


def test_slots_that_the_artist_filled_since_stay_his(scene):
    obj = quad(scene)
    write(scene, LAYOUT, obj)
    material = principled()
    obj.material_slots[0].material = material
    remove.remove(scene, [obj])
    assert obj.material_slots[0].material == material


@pytest.mark.parametrize("baked_before", [False, True])
def test_a_write_that_fails_changes_nothing(scene, monkeypatch, baked_before):
    objects = scenery(scene)
    if baked_before:
        write(scene, Layout(2), *objects)
    state = snapshot.of(scene)
    baked = [random_bake(obj, LAYOUT, seed=9) for obj in objects]

    def fail(*_):
        raise RuntimeError("while the last material is attached")

    count = iter(range(10))
    attach = materials.attach
    monkeypatch.setattr(materials, "attach", lambda *a: fail() if next(count) == 1 else attach(*a))
    with pytest.raises(RuntimeError, match="last material"):
        writeback.write(scene, baked, LAYOUT)
    monkeypatch.undo()
    after = snapshot.of(scene)
    for what in state:
        assert after[what] == state[what], what


def test_a_mesh_edited_while_it_baked_is_refused_and_nothing_changes(scene):
    objects = scenery(scene)
    baked = [random_bake(obj, LAYOUT) for obj in objects]
    obj, result, stamp = baked[-1]
    short = ReceiverResult(obj.name, result.transfer[:3], result.element_points[:3])
    state = snapshot.of(scene)
    with pytest.raises(BakeError, match="'Empty Slots' was edited while it baked"):
        writeback.write(scene, [*baked[:-1], (obj, short, stamp)], LAYOUT)
    assert snapshot.of(scene) == state
