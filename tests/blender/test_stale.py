"""A bake is shown exactly as long as it fits its object."""

import bpy
import numpy as np
import pytest
from bakes import principled, quad, write
from prt_baker.addon import scene as scenes
from prt_baker.addon import stale, stamp
from prt_baker.addon.prt.layout import Layout


@pytest.fixture
def baked(scene):
    """A baked square."""
    obj = quad(scene, x=2, material=principled())
    write(scene, Layout(2), obj)
    bpy.context.view_layer.update()
    assert is_shown(obj)
    return obj


def is_shown(obj):
    bpy.context.view_layer.update()
    evaluated = obj.evaluated_get(bpy.context.evaluated_depsgraph_get())
    assert evaluated[stamp.SWITCH] == obj[stamp.SWITCH]
    assert (stale.reason(obj, stamp.read(obj)) is None) == bool(obj[stamp.SWITCH])
    return bool(obj[stamp.SWITCH])


def counted(monkeypatch, owner, name):
    calls, real = [], getattr(owner, name)
    monkeypatch.setattr(owner, name, lambda *a: calls.append(a) or real(*a))
    return calls


@pytest.mark.parametrize(
    ("name", "value"),
    [("location", (2, 0.01, 0)), ("rotation_euler", (0, 0.01, 0)), ("scale", (1, 1, 1.01))],
)
def test_a_moved_object_is_stale_until_it_is_back(baked, name, value):
    before = tuple(getattr(baked, name))
    setattr(baked, name, value)
    assert not is_shown(baked)
    assert "moved" in stale.reason(baked, stamp.read(baked))
    setattr(baked, name, before)
    assert is_shown(baked)


def test_an_object_moved_by_its_parent_is_stale(scene, baked):
    parent = bpy.data.objects.new("Parent", None)
    scene.collection.objects.link(parent)
    baked.parent = parent
    assert is_shown(baked)
    parent.location.z = 1
    assert not is_shown(baked)
    parent.location.z = 0
    assert is_shown(baked)


def test_an_edited_mesh_is_stale_until_it_is_back(baked):
    baked.data.vertices[0].co.z = 0.5
    baked.data.update()
    assert not is_shown(baked)
    assert "edited" in stale.reason(baked, stamp.read(baked))
    baked.data.vertices[0].co.z = 0
    baked.data.update()
    assert is_shown(baked)


def test_a_mesh_is_looked_at_when_edit_mode_is_left(baked):
    bpy.context.view_layer.objects.active = baked
    bpy.ops.object.mode_set(mode="EDIT")
    bpy.ops.mesh.select_all(action="SELECT")
    bpy.ops.transform.translate(value=(0, 0, 1))
    assert is_shown(baked)
    bpy.ops.object.mode_set(mode="OBJECT")
    assert not is_shown(baked)


def test_what_does_not_move_the_surface_keeps_the_bake(baked):
    baked.data.attributes.new("Colour", "FLOAT_COLOR", "POINT")
    baked.data.uv_layers.new(name="Map")
    baked.data.update()
    baked.data.materials[0].diffuse_color = (1, 0, 0, 1)
    baked.name = "Another Name"
    assert is_shown(baked)


def test_rounding_of_a_far_place_is_no_move(scene):
    obj = quad(scene, x=30000, material=principled())
    write(scene, Layout(2), obj)
    obj.location.x = np.nextafter(np.float32(30000), np.float32(np.inf))
    assert is_shown(obj)


def test_a_drag_reads_no_mesh(baked, monkeypatch):
    signatures = counted(monkeypatch, scenes, "mesh_signature")
    for step in range(1, 5):
        baked.location.x = step + 5
        bpy.context.view_layer.update()
    assert not is_shown(baked)
    assert not signatures


def test_objects_without_a_bake_cost_nothing(scene, baked, monkeypatch):
    other = quad(scene, x=5, name="Other")
    looks = counted(monkeypatch, stamp, "read")
    other.location.x = 6
    bpy.context.view_layer.update()
    assert not looks


def test_refresh_finds_what_happened_unseen(scene, baked):
    stale.unregister()
    try:
        baked.location.x = 7
        bpy.context.view_layer.update()
        assert baked[stamp.SWITCH]
    finally:
        stale.register()
    stale.refresh(scene)
    assert not baked[stamp.SWITCH]
