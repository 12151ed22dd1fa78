"""Light without bounces in a .blend: kept beside the whole where the artist wants it, read by no
material, and gone with the bake."""

from dataclasses import replace
from pathlib import Path

import bpy
import numpy as np
import pytest
import snapshot
from bakes import shader
from prt_baker.addon import (
    atlas_images,
    attributes,
    bake,
    carrier,
    material_attributes,
    properties,
    remove,
    stamp,
    writeback,
)
from prt_baker.addon.atlas_files import Target
from prt_baker.addon.prt import layout as layouts
from prt_baker.addon.prt.errors import BakeError
from prt_baker.addon.prt.files.atlases import read_tiles
from prt_baker.addon.prt.steps import value_of
from test_bounced_scenes import corner

__all__ = ["corner"]  # a fixture


@pytest.fixture
def red(corner):
    """The corner with a red wall."""
    wall = corner[1].data.materials[0]
    shader(wall).inputs["Base Color"].default_value = (0.8, 0.1, 0.1, 1)
    bpy.context.view_layer.update()
    return [obj.name for obj in corner]


def few(scene, **changes):
    return replace(properties.settings(scene), **{"rays": 16, "bounces": 1, "cache": "", **changes})


def baked(scene, names, target=Target(), **changes):  # noqa: B008 - frozen
    report = value_of(bake.bake(scene.name, names, few(scene, **changes), target=target))
    return report, [stamp.read(bpy.data.objects[name]) for name in names]


def held(name, prefix="_PRT_"):
    """The attributes of an object that begin with ``prefix``, by name."""
    holder = carrier.of(bpy.data.objects[name]) or bpy.data.objects[name]
    stored = attributes.take(holder.data)
    return {k: v for k, (_, v) in stored.items() if k.removeprefix(prefix).isdigit()}


def direct_of(name):
    mark = stamp.read(bpy.data.objects[name])
    names = mark.packing.direct.called("_PRT_DIRECT_")
    stored = held(name, "_PRT_DIRECT_")
    assert set(stored) == set(names)
    columns = np.concatenate([stored[k] for k in names], axis=1)
    return layouts.unpack(mark.packing.direct, columns)


@pytest.mark.parametrize("by_modifier", [False, True])
def test_it_is_kept_beside_the_whole_which_stays_as_it_is(scene, red, by_modifier):
    if by_modifier:
        for name in red:
            bpy.data.objects[name].modifiers.new("Triangulate", "TRIANGULATE")
    plain, marks = baked(scene, red)
    assert not any(mark.direct for mark in marks)
    before = [held(name) for name in red]
    assert not held(red[0], "_PRT_DIRECT_")
    kept, marks = baked(scene, red, keep_direct=True)
    assert all(mark.direct and mark.by_modifier == by_modifier for mark in marks)
    rays = [[entry["rays"] for entry in report["objects"]] for report in (plain, kept)]
    assert rays[0] == rays[1]
    for name, its in zip(red, before, strict=True):
        for attribute, values in held(name).items():
            np.testing.assert_array_equal(values, its[attribute])
    found = [direct_of(name) for name in red]
    _, (alone, _) = baked(scene, red, bounces=0, keep_direct=True)
    assert not alone.direct
    truth = attributes.read(bpy.data.objects[red[0]], alone)
    np.testing.assert_array_equal(found[0].transfer, truth.transfer)
    assert not held(red[0], "_PRT_DIRECT_")


def test_no_material_reads_it_so_14_attributes_hold_as_much_as_before(scene, red):
    """Order 4 in three channels: 12 for EEVEE, and 4 more on the mesh."""
    _, (mark, _) = baked(scene, red, order=4, keep_direct=True)
    assert len(mark.packing.attributes) == 12
    assert len(held(red[0], "_PRT_DIRECT_")) == 4
    material = bpy.data.objects[red[0]].data.materials[0]
    assert not any("DIRECT" in str(read) for read in material_attributes.of(material))


@pytest.mark.parametrize("by_modifier", [False, True])
@pytest.mark.parametrize("kind", ["vertex", "texture"])
def test_remove_bake_takes_it_away(scene, red, kind, by_modifier):
    if by_modifier:
        bpy.data.objects[red[0]].modifiers.new("Triangulate", "TRIANGULATE")
        bpy.context.view_layer.update()
    state = snapshot.of(scene)
    baked(scene, red, Target(kind), keep_direct=True, resolution=64)
    assert snapshot.of(scene) != state
    remove.remove(scene, [bpy.data.objects[name] for name in red])
    assert snapshot.of(scene) == state
    assert not [image for image in bpy.data.images if atlas_images.of(image)]


def test_a_write_that_fails_leaves_the_earlier_one(scene, red, monkeypatch):
    baked(scene, red, keep_direct=True)
    before = direct_of(red[0])
    monkeypatch.setattr(writeback, "_attach", lambda *_: 1 / 0)
    with pytest.raises(ZeroDivisionError):
        baked(scene, red, bounces=2, keep_direct=True, seed=3)
    np.testing.assert_array_equal(direct_of(red[0]).transfer, before.transfer)


class TestTextures:
    def images(self, name):
        return atlas_images.both(stamp.image_of(bpy.data.objects[name]))

    def test_a_second_image_lies_beside_the_first(self, scene, red, tmp_path):
        target = Target("texture", tmp_path, "room")
        bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "room.blend"))
        _, (mark, _) = baked(scene, red, target, keep_direct=True, resolution=64)
        assert mark.direct
        whole, direct = self.images(red[0])
        assert self.images(red[1]) == [whole, direct]
        assert direct.filepath == "//room PRT_direct.exr"
        values, names = read_tiles(tmp_path / "room PRT_direct.exr")
        assert names == tuple(f"T{i}" for i in range(9))
        shown = atlas_images.columns(direct, 3)[..., :9]
        np.testing.assert_array_equal(shown, values)
        brighter = atlas_images.columns(whole, 7)[..., :3].mean(axis=(0, 1)) - shown[..., 0].mean()
        assert brighter[0] > 1.5 * brighter[1] > 0  # the wall is red
        bpy.ops.wm.save_mainfile()
        bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "room.blend"))
        _, again = self.images(red[0])
        np.testing.assert_array_equal(atlas_images.columns(again, 3)[..., :9], values)

    def test_an_unsaved_file_keeps_both_inside(self, scene, red):
        baked(scene, red, Target("texture"), keep_direct=True, resolution=64)
        assert all(image.packed_file for image in self.images(red[0]))
        baked(scene, red, Target("texture"), resolution=64)
        assert len(self.images(red[0])) == 1
        assert len([image for image in bpy.data.images if atlas_images.of(image)]) == 1

    def test_a_later_bake_without_it_takes_the_file_away(self, scene, red, tmp_path, monkeypatch):
        target, names = Target("texture", tmp_path, "room"), ["room PRT.exr", "room PRT_direct.exr"]

        def found():
            return sorted(path.name for path in tmp_path.iterdir())

        baked(scene, red, target, keep_direct=True, resolution=64)
        other = tmp_path / "den PRT_direct.exr"
        other.write_bytes((tmp_path / names[1]).read_bytes())
        with monkeypatch.context() as patch:
            patch.setattr(writeback, "_attach", lambda *_: 1 / 0)
            with pytest.raises(ZeroDivisionError):
                baked(scene, red, target, resolution=64)
        assert found() == [other.name, *names]
        baked(scene, red, target, resolution=64)
        assert found() == [other.name, names[0]]

    def test_a_picture_of_the_artists_in_its_place_stays(self, scene, red, tmp_path):
        place = Path(tmp_path) / "room PRT_direct.exr"
        place.write_bytes(b"a painting")
        with pytest.raises(BakeError, match="is a picture of yours"):
            baked(scene, red, Target("texture", tmp_path, "room"), keep_direct=True, resolution=64)
        assert [path.name for path in tmp_path.iterdir()] == [place.name]
        assert place.read_bytes() == b"a painting"
        assert not any(stamp.KEY in bpy.data.objects[name] for name in red)
        baked(scene, red, Target("texture", tmp_path, "room"), resolution=64)
        assert place.read_bytes() == b"a painting"
