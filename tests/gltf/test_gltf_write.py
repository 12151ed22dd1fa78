"""A .glb is valid and whole, or not there."""

import resource

import bpy
import numpy as np
import pytest
from glb import Glb
from gltf_scenes import COLORS, colored, monkey, sheared
from gltf_validator import assert_valid
from prt_baker.addon import carrier, gltf_export
from prt_baker.addon.prt.errors import BakeError


def test_nan_becomes_zero(scene, bake, out):
    """On a carrier, because the exporter repairs the meshes of the scene."""
    obj = monkey()
    bake(obj, by_modifier=True)
    holder = carrier.of(obj).data
    values = np.ones((len(holder.vertices), 4), np.float32)
    values[3] = np.nan, np.inf, -np.inf, 1
    holder.attributes["_PRT_1"].data.foreach_set("color", values.ravel())
    holder.update_tag()
    gltf_export.write(str(out))
    assert np.isfinite(Glb(out).transfer(obj.name)).all()
    assert_valid(out)


def own_material(obj):
    """One material shows one layout."""
    obj.data.materials.append(bpy.data.materials.new(obj.name))
    return obj


def test_gltf_validator_finds_no_error(scene, bake, out):
    bake(own_material(sheared()), channels=3, turns=2, lights=2)
    bake(own_material(monkey("Corner")), domain="CORNER")
    subdivided = own_material(monkey("Subdivided"))
    subdivided.modifiers.new("Subdivision", "SUBSURF")
    bake(subdivided, order=5, by_modifier=True)
    bake(colored(COLORS, "Dirt"))
    monkey("Unbaked")
    gltf_export.write(str(out))
    assert_valid(out)


@pytest.mark.parametrize("subdivided", [True, False])
def test_shape_keys_are_animated_where_the_baked_mesh_has_them(scene, bake, out, subdivided):
    obj = monkey()
    obj.shape_key_add(name="Basis")
    key = obj.shape_key_add(name="Key")
    for frame, value in ((1, 0), (20, 1)):
        key.value = value
        key.keyframe_insert("value", frame=frame)
    if subdivided:
        obj.modifiers.new("Subdivision", "SUBSURF")
    bake(obj, by_modifier=subdivided)
    gltf_export.write(str(out))
    glb = Glb(out)
    assert glb.prt(obj.name)
    assert ("animations" in glb.document) != subdivided
    assert_valid(out)


def test_a_full_disk_is_one_sentence(scene, bake, out, tmp_path):
    bake(monkey())
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (10_000, before[1]))
    try:
        with pytest.raises(BakeError, match=f"{out} cannot be written: File too large"):
            gltf_export.write(str(out))
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
    assert not list(tmp_path.iterdir())


def test_the_validator_can_fail(scene, bake, out):
    bake(monkey())
    gltf_export.write(str(out))
    data = out.read_bytes()
    out.write_bytes(data.replace(b'"_PRT_0"', b'"-PRT_0"'))
    with pytest.raises(AssertionError, match="INVALID_ATTRIBUTE"):
        assert_valid(out)


def test_hidden_objects_stay_out(scene, bake, out):
    bake(monkey("Shown"))
    bake(monkey("Hidden"))
    bpy.data.objects["Hidden"].hide_set(True)
    gltf_export.write(str(out))
    assert set(Glb(out).nodes) == {"Shown"}
    with pytest.raises(BakeError, match="'Hidden' is hidden"):
        gltf_export.write(str(out), ["Hidden"])


@pytest.mark.parametrize("name", ["folder.glb", "missing/scene.glb", "scene.gltf", "scene"])
def test_a_path_that_cannot_be_written_is_one_sentence(scene, bake, tmp_path, name):
    (tmp_path / "folder.glb").mkdir()
    bake(monkey())
    with pytest.raises(BakeError) as error:
        gltf_export.write(str(tmp_path / name))
    assert str(tmp_path) in str(error.value)
    assert [p.name for p in tmp_path.iterdir()] == ["folder.glb"]


def test_a_bake_that_does_not_arrive_is_told_and_the_old_file_stays(
    scene, bake, out, monkeypatch, tmp_path
):
    out.write_bytes(b"old")
    obj = monkey()
    bake(obj)
    obj.data.attributes.remove(obj.data.attributes["_PRT_1"])
    with pytest.raises(RuntimeError, match="did not reach"):
        gltf_export.write(str(out))
    assert out.read_bytes() == b"old"
    assert list(tmp_path.iterdir()) == [out]


def test_the_package_stands_in_the_preferences_only_while_it_exports(scene, bake, out):
    addons = bpy.context.preferences.addons
    before = list(addons.keys())
    bake(monkey())
    gltf_export.write(str(out))
    assert list(addons.keys()) == before
