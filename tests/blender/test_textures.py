"""The whole way into textures: what is written, what stays the artist's, what goes wrong."""

import os
from dataclasses import replace

import bpy
import numpy as np
import pytest
import snapshot
import textured
from bakes import place, principled, quad
from pictures import colour, look_down, render
from prt_baker.addon import (
    atlas_files,
    atlas_images,
    bake,
    remove,
    stale,
    stamp,
    textures,
    uv_maps,
    writeback,
)
from prt_baker.addon.atlas_files import Target
from prt_baker.addon.prt.errors import BakeError
from prt_baker.addon.prt.job import Settings
from prt_baker.addon.prt.layout import Layout
from prt_baker.addon.prt.steps import value_of
from test_bake import baked as on_vertices
from worlds import environment, generated, picture

LAYOUT = Layout(3, turns=1)
FEW = Settings(rays=32, seed=5, threads=1, resolution=64)


def saved(scene, folder):
    """The scene in a .blend in ``folder``, and where its textures go."""
    bpy.ops.wm.save_as_mainfile(filepath=str(folder / "room.blend"))
    return Target("texture", folder, "room")


def stage(scene, count=2):
    """Squares above each other, under a sky."""
    environment(scene, generated(picture()))
    objects = [quad(scene, material=principled(f"M{k}"), name=f"Quad{k}") for k in range(count)]
    for k, obj in enumerate(objects):
        obj.location.z = 0.4 * k
    bpy.context.view_layer.update()
    return [obj.name for obj in objects]


def baked(scene, names, target, settings=FEW):
    return value_of(bake.bake(scene.name, names, settings, target=target))


def marks(*names):
    return [stamp.read(bpy.data.objects[name]) for name in names]


class TestBake:
    def test_one_texture_beside_the_blend_shows_all(self, scene, tmp_path):
        names = stage(scene)
        target = saved(scene, tmp_path)
        active = [bpy.data.objects[name].data.uv_layers.new(name="Mine").name for name in names]
        baked(scene, names, target)
        [image] = [image for image in bpy.data.images if atlas_images.of(image)]
        assert (tmp_path / "room PRT.exr").exists()
        assert image.filepath == "//room PRT.exr"
        assert image.colorspace_settings.name == "Non-Color"
        assert not image.use_half_precision
        for name, mark in zip(names, marks(*names), strict=True):
            obj = bpy.data.objects[name]
            assert stamp.image_of(obj) == image
            assert obj[stamp.SWITCH] == 1.0
            assert (mark.carrier, mark.domain, mark.atlas_size) == ("texture", "CORNER", 64)
            assert [layer.name for layer in obj.data.uv_layers] == [active[0], "PRT"]
            assert obj.data.uv_layers.active.name == active[0]
            assert obj.data.uv_layers["Mine"].active_render
            assert stale.reason(obj, mark) is None

    @pytest.mark.parametrize("bounces", [0, 2])
    def test_it_looks_like_a_bake_on_many_vertices(self, scene, tmp_path, bounces):
        """With bounces the upper square is red from below, and so is what it lights."""
        names = stage(scene)
        above = bpy.data.materials["M1"].node_tree.nodes["Principled BSDF"]
        above.inputs["Base Color"].default_value = (0.9, 0.2, 0.1, 1)
        target = saved(scene, tmp_path)
        look_down(scene, 1, 1)
        scene.camera.location.z = 0.3  # under the upper square
        many = replace(FEW, rays=256, resolution=128, bounces=bounces)
        baked(scene, names, target, many)
        [mark] = marks(names[0])
        assert (mark.bounces, mark.channels) == (bounces, 3 if bounces else 1)
        first = colour(render(scene, tmp_path), "Combined")
        remove.remove(scene, [bpy.data.objects[name] for name in names])
        for name in names:
            modifier = bpy.data.objects[name].modifiers.new("Subdivision", "SUBSURF")
            modifier.subdivision_type = "SIMPLE"
            modifier.levels = modifier.render_levels = 5
        on_vertices(scene, [bpy.data.objects[name] for name in names], many)
        second = colour(render(scene, tmp_path), "Combined")
        assert np.ptp(second) > 0.1 * second.mean()
        assert np.abs(first - second).mean() < 0.02 * second.mean()

    def test_an_unsaved_file_keeps_its_texture_inside(self, scene, tmp_path):
        names = stage(scene)
        baked(scene, names, Target("texture"))
        [image] = [image for image in bpy.data.images if atlas_images.of(image)]
        assert image.packed_file
        bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "later.blend"))
        bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "later.blend"))
        obj = bpy.data.objects[names[0]]
        assert stamp.image_of(obj).has_data or 0 not in stamp.image_of(obj).size
        assert obj[stamp.SWITCH] == 1.0

    def test_a_second_bake_takes_the_place_of_the_first(self, scene, tmp_path):
        names = stage(scene)
        target = saved(scene, tmp_path)
        for seed in (1, 2):
            baked(scene, names, target, replace(FEW, seed=seed))
        assert [path.name for path in tmp_path.glob("*.exr")] == ["room PRT.exr"]
        assert [i.name for i in bpy.data.images if atlas_images.of(i)] == ["PRT Atlas"]
        assert all(obj.get(stamp.SWITCH) == 1.0 for obj in scene.objects if obj.name in names)

    def test_another_object_later_leaves_the_first_texture_alone(self, scene, tmp_path):
        names = stage(scene)
        target = saved(scene, tmp_path)
        for name in names:
            baked(scene, [name], target)
        assert sorted(path.name for path in tmp_path.glob("*.exr")) == [
            "room PRT 2.exr",
            "room PRT.exr",
        ]
        assert all(stale.reason(bpy.data.objects[n], m) is None for n, m in
                   zip(names, marks(*names), strict=True))  # fmt: skip

    def test_own_textures_are_called_like_their_objects(self, scene, tmp_path):
        names = stage(scene)
        baked(scene, names, saved(scene, tmp_path), replace(FEW, shared_atlas=False))
        found = sorted(path.name for path in tmp_path.glob("*.exr"))
        assert found == ["room PRT Quad0.exr", "room PRT Quad1.exr"]

    def test_the_uv_map_of_an_earlier_bake_is_used_again(self, scene, tmp_path):
        names = stage(scene)
        target = saved(scene, tmp_path)
        maps = []
        for seed in (1, 2):
            baked(scene, names, target, replace(FEW, seed=seed))
            maps.append(uv_maps.read(bpy.data.objects[names[0]].data))
        np.testing.assert_array_equal(*maps)
        objects = [bpy.data.objects[name] for name in names]
        from prt_baker.addon import scene as scenes

        read = textures.receivers(objects, scenes.check_objects(objects), target)
        assert all(receiver.uv_key == mark.uv_key != "" for receiver, mark in
                   zip(read, marks(*names), strict=True))  # fmt: skip

    def test_modifiers_and_shared_meshes_have_their_own_places(self, scene, tmp_path):
        names = stage(scene, 1)
        first = bpy.data.objects[names[0]]
        second = place(scene, first.data, 2, 0)
        third = quad(scene, 4, 0, first.data.materials[0], "Sub")
        third.modifiers.new("Subdivision", "SUBSURF").subdivision_type = "SIMPLE"
        names = [obj.name for obj in (first, second, third)]
        baked(scene, names, saved(scene, tmp_path))
        assert [mark.by_modifier for mark in marks(*names)] == [True] * 3
        objects = [bpy.data.objects[name] for name in names]
        shown = [textured_uvs(obj) for obj in objects]
        assert (shown[0] != shown[1]).all()
        assert not first.data.attributes.get("PRT")

    def test_verify_measures_what_the_image_shows(self, scene, tmp_path):
        names = stage(scene)
        target = saved(scene, tmp_path)
        baked(scene, names, target, replace(FEW, rays=128))
        value_of(bake.verify(scene.name, names, replace(FEW, verify_points=60, verify_rays=4096)))
        good = [mark.measured_error for mark in marks(*names)]
        assert max(good) < 0.06
        image = stamp.image_of(bpy.data.objects[names[0]])
        pixels = np.empty(4 * image.size[0] * image.size[1], np.float32)
        image.pixels.foreach_get(pixels)
        image.pixels.foreach_set(1.3 * pixels)
        value_of(bake.verify(scene.name, names, replace(FEW, verify_points=60, verify_rays=4096)))
        assert min(mark.measured_error for mark in marks(*names)) > 0.25


def textured_uvs(obj):
    """The map PRT that ``obj`` shows."""
    from prt_baker.addon import carrier

    with carrier.evaluated_mesh(obj, bpy.context.evaluated_depsgraph_get()) as mesh:
        return uv_maps.read(mesh)


class TestRemove:
    def test_the_file_is_what_it_was(self, scene, tmp_path):
        plain = quad(scene, 0, 0, principled())
        bare = quad(scene, 2, 0, name="Bare")
        bent = quad(scene, 4, 0, name="Bent")
        bent.modifiers.new("Array", "ARRAY")
        twins = [quad(scene, 6, 0, name="Twin")]
        twins.append(place(scene, twins[0].data, 8, 0))
        plain.data.uv_layers.new(name="Mine")
        bpy.context.view_layer.update()
        objects = [plain, bare, bent, *twins]
        state = snapshot.of(scene)
        for seed in (0, 1):
            textured.write(scene, tmp_path, LAYOUT, *objects, seed=seed)
        assert snapshot.of(scene) != state
        assert len(bpy.data.images) == 1
        assert remove.remove(scene, objects) == len(objects)
        assert snapshot.of(scene) == state
        assert not bpy.data.images

    def test_vertices_after_a_texture_leave_nothing_of_it(self, scene, tmp_path):
        names = stage(scene)
        baked(scene, names, saved(scene, tmp_path))
        on_vertices(scene, [bpy.data.objects[name] for name in names])
        obj = bpy.data.objects[names[0]]
        assert stamp.read(obj).carrier == "vertex"
        assert not obj.data.uv_layers
        assert not any(atlas_images.of(image) for image in bpy.data.images)
        assert stamp.image_of(obj) is None

    def test_a_map_of_the_artists_is_used_and_stays(self, scene, tmp_path):
        names = stage(scene)
        obj = bpy.data.objects[names[0]]
        layer = obj.data.uv_layers.new(name="PRT")
        uvs = 0.1 + 0.8 * textured.plane_uvs(obj)
        layer.data.foreach_set("uv", uvs.ravel())
        baked(scene, names, saved(scene, tmp_path))
        assert [mark.own_uvs for mark in marks(*names)] == [True, False]
        np.testing.assert_array_equal(uv_maps.read(obj.data), uvs.astype(np.float32))
        remove.remove(scene, [bpy.data.objects[name] for name in names])
        np.testing.assert_array_equal(uv_maps.read(obj.data), uvs.astype(np.float32))
        assert not bpy.data.objects[names[1]].data.uv_layers


class TestMaterials:
    def test_a_material_in_two_textures_is_refused(self, scene, tmp_path):
        material = principled()
        first, second = quad(scene, material=material), quad(scene, 2, 0, material)
        textured.write(scene, tmp_path, LAYOUT, first)
        with pytest.raises(BakeError, match="was baked in a texture and shares material 'Mat"):
            textured.write(scene, tmp_path, LAYOUT, second)
        with pytest.raises(BakeError, match="shares material"):
            writeback.check(scene, [second], LAYOUT)

    def test_attributes_and_textures_of_the_material_are_counted(self, scene):
        from bakes import add, full, link, shader

        writeback.check(scene, [quad(scene, material=full(13))], LAYOUT, carriers=["texture"])
        with pytest.raises(BakeError, match="reads 14 attributes"):
            writeback.check(scene, [quad(scene, material=full(14))], LAYOUT, carriers=["texture"])
        material, total = principled("Many"), None
        for k in range(30):
            node, term = add(material, "TexImage"), add(material, "VectorMath")
            node.image = bpy.data.images.new(f"I{k}", 4, 4)
            link(material, node.outputs[0], term.inputs[0])
            if total is not None:
                link(material, total, term.inputs[1])
            total = term.outputs[0]
        link(material, total, shader(material).inputs["Base Color"])
        with pytest.raises(BakeError, match="reads 30 textures"):
            writeback.check(scene, [quad(scene, material=material)], LAYOUT, carriers=["texture"])

    def test_a_texture_larger_than_cards_take_is_refused(self, scene, tmp_path):
        names = stage(scene)
        with pytest.raises(BakeError, match="choose at most 8192"):
            baked(scene, names, saved(scene, tmp_path), replace(FEW, resolution=16384))


class TestWhatGoesWrong:
    def untouched(self, scene, names, target, match):
        state, files = snapshot.of(scene), sorted(target.folder.iterdir())
        contents = [path.read_bytes() for path in files if path.is_file()]
        with pytest.raises(BakeError, match=match):
            baked(scene, names, target)
        assert snapshot.of(scene) == state
        assert sorted(target.folder.iterdir()) == files
        assert [path.read_bytes() for path in files if path.is_file()] == contents
        assert not any(atlas_images.of(image) for image in bpy.data.images)

    def test_a_picture_of_the_same_name_stays_the_artists(self, scene, tmp_path):
        names = stage(scene)
        target = saved(scene, tmp_path)
        (tmp_path / "room PRT.exr").write_bytes(b"a painting")
        self.untouched(scene, names, target, "is a picture of yours")

    def test_an_image_of_the_same_name_in_the_file_stays_the_artists(self, scene, tmp_path):
        names = stage(scene)
        mine = bpy.data.images.new(textures.NAME, 4, 4)
        baked(scene, names, saved(scene, tmp_path))
        assert bpy.data.images[textures.NAME] == mine

    @pytest.mark.skipif(os.geteuid() == 0, reason="root may write everywhere")
    def test_a_folder_without_the_right_to_write(self, scene, tmp_path):
        names = stage(scene)
        saved(scene, tmp_path)
        locked = tmp_path / "locked"
        locked.mkdir(mode=0o555)
        self.untouched(scene, names, Target("texture", locked, "room"), "cannot be written")

    def test_a_folder_that_is_not_there(self, scene, tmp_path):
        names = stage(scene)
        saved(scene, tmp_path)
        with pytest.raises(BakeError, match="does not exist"):
            baked(scene, names, Target("texture", tmp_path / "no", "room"))

    def test_a_disk_that_is_full_when_the_texture_is_copied(self, scene, tmp_path, monkeypatch):
        names = stage(scene)
        target = saved(scene, tmp_path)

        def full(_source, place):
            place.write_bytes(b"half")
            raise OSError(28, "No space left on device")

        monkeypatch.setattr(atlas_files.shutil, "copyfile", full)
        self.untouched(scene, names, target, "No space left on device")

    def test_an_earlier_texture_survives_a_bake_that_fails(self, scene, tmp_path, monkeypatch):
        names = stage(scene)
        target = saved(scene, tmp_path)
        baked(scene, names, target)
        before = (tmp_path / "room PRT.exr").read_bytes()

        def fail(*_, **__):
            raise RuntimeError("while it is written")

        monkeypatch.setattr(writeback, "write", fail)
        with pytest.raises(RuntimeError, match="while it is written"):
            baked(scene, names, target, replace(FEW, seed=9))
        assert (tmp_path / "room PRT.exr").read_bytes() == before
        assert [path.name for path in tmp_path.glob("*.exr")] == ["room PRT.exr"]
        assert sum(atlas_images.of(image) is not None for image in bpy.data.images) == 1
        assert all(stale.reason(bpy.data.objects[n], m) is None for n, m in
                   zip(names, marks(*names), strict=True))  # fmt: skip


class TestStale:
    def test_a_texture_that_is_gone_shows_the_artists_shader(self, scene, tmp_path):
        names = stage(scene)
        baked(scene, names, saved(scene, tmp_path))
        bpy.ops.wm.save_mainfile()
        (tmp_path / "room PRT.exr").unlink()
        bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "room.blend"))
        obj = bpy.data.objects[names[0]]
        assert obj[stamp.SWITCH] == 0.0
        assert "is gone or another bake's" in stale.reason(obj, stamp.read(obj))

    def test_a_texture_of_another_bake_is_told(self, scene, tmp_path):
        names = stage(scene)
        target = saved(scene, tmp_path)
        baked(scene, names, target)
        bpy.ops.wm.save_mainfile()
        baked(scene, names, target, replace(FEW, seed=8))
        assert all(bpy.data.objects[name][stamp.SWITCH] == 1.0 for name in names)
        bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "room.blend"))
        assert all(bpy.data.objects[name][stamp.SWITCH] == 0.0 for name in names)

    def test_it_survives_save_and_load(self, scene, tmp_path):
        names = stage(scene)
        baked(scene, names, saved(scene, tmp_path))
        bpy.data.objects[names[0]].location.x += 0  # nothing
        bpy.ops.wm.save_mainfile()
        bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "room.blend"))
        for name in names:
            obj = bpy.data.objects[name]
            assert obj[stamp.SWITCH] == 1.0
            assert tuple(stamp.image_of(obj).size) == (128, 128)


def test_files_say_which_bake_they_are_of(tmp_path):
    textured.atlas(tmp_path, LAYOUT, 8)
    assert atlas_files.job_hash(tmp_path / "PRT Atlas 0.exr") == "test"
    (tmp_path / "other.exr").write_bytes(b"sky")
    assert atlas_files.job_hash(tmp_path / "other.exr") is None
    assert atlas_files.job_hash(tmp_path / "missing.exr") is None
