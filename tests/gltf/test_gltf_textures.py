"""Bakes in textures arrive in a .glb: numbers within the error stated, and the UVs that read
them."""

import bpy
import numpy as np
import pytest
from glb import Glb
from gltf_laws import Y_UP, light_of
from gltf_scenes import export, monkey, rotated, sheared
from gltf_textured import bake_in_texture
from gltf_validator import assert_valid
from prt_baker.addon import carrier, gltf_export, light_state, stamp, uv_maps
from prt_baker.addon.prt import layout as layouts
from prt_baker.addon.prt import sh
from prt_baker.addon.prt.layout import Layout

LAYOUTS = {
    "order 2": Layout(2),
    "order 3, residual": Layout(3, turns=1),
    "order 4, twelve turns": Layout(4, turns=12),
    "order 5, peaks": Layout(5, turns=1, lights=2),
    "order 3, three channels": Layout(3, channels=3, turns=1),
    "order 3, what is seen": Layout(3, turns=1, visibility_order=3),
    "order 5, three channels": Layout(5, channels=3, turns=1, lights=4),
}


@pytest.mark.parametrize("layout", LAYOUTS.values(), ids=LAYOUTS)
def test_every_texel_is_there_within_the_error_stated(scene, out, tmp_path, layout):
    obj = rotated()
    values = bake_in_texture(tmp_path, [obj], layout)
    gltf_export.write(str(out), [obj.name])
    glb = Glb(out)
    prt = glb.prt(obj.name)
    assert len(prt["texture"]["images"]) == -(-sum(map(bool, layout.slots)) // 3)
    assert (prt["order"], prt["channels"]) == (layout.order, layout.channels)
    flat = values[::-1].reshape(-1, values.shape[2])
    truth = layouts.unpack(layout, flat)
    turn, seen = sh.rotation_matrix(Y_UP, 5).T, truth.visibility_sh
    coefficients = truth.transfer @ turn[: layout.order**2, : layout.order**2]
    parts = (coefficients, truth.residual, truth.visibility)
    parts += (seen @ turn[: seen.shape[1], : seen.shape[1]],)
    turned = layouts.pack(layout, layouts.Values(*(part.astype(np.float32) for part in parts)))
    found = glb.atlas(obj.name).reshape(len(flat), -1)
    for k, slot in enumerate(layout.slots):
        if slot:
            place = prt["layout"].index(slot)
            error = prt["scale"][place] / 131070 + 1e-6 * abs(turned[:, k]).max()
            difference = np.abs(found[:, place] - turned[:, k])
            assert difference.max() <= error, slot
            assert np.ptp(found[:, place]) > 0.9 * np.ptp(turned[:, k])
    assert_valid(out)


def test_the_light_is_within_the_stated_error(scene, out, tmp_path):
    """Exit radiance is off by at most Σ scale_i |L_i| / 131070."""
    obj = sheared()
    values = bake_in_texture(tmp_path, [obj], Layout(3))
    gltf_export.write(str(out))
    glb = Glb(out)
    seen = glb.atlas(obj.name)[..., :9] @ light_of(glb, 3)
    truth = values[::-1, :, :9] @ light_state.read(scene).radiance_sh[:9]
    bound = np.array(glb.prt(obj.name)["scale"])[:9] @ np.abs(light_of(glb, 3)) / 131070
    difference = np.abs(seen - truth).max(axis=(0, 1))
    assert (difference > 0).all()
    assert (difference <= bound + 1e-6).all()


def corners(obj):
    """Position (in its own frame, Y up) and UV (v down) of every corner of ``obj``."""
    with carrier.evaluated_mesh(obj, bpy.context.evaluated_depsgraph_get()) as mesh:
        uvs = uv_maps.read(mesh)
        at = np.array([mesh.vertices[loop.vertex_index].co for loop in mesh.loops])
    return np.concatenate([at @ Y_UP.T, uvs * (1, -1) + (0, 1)], axis=1)


def rows(values):
    return np.unique(np.round(values.astype(np.float64), 5), axis=0)


SURFACES = {
    "as it is": lambda obj: None,
    "with UVs of its own": lambda obj: obj.data.uv_layers.new(name="Mine"),
    "without": lambda obj: obj.data.uv_layers.remove(obj.data.uv_layers[0]),
    "subdivided": lambda obj: obj.modifiers.new("Subdivision", "SUBSURF"),
}


@pytest.mark.parametrize("change", SURFACES.values(), ids=SURFACES)
def test_the_extras_name_the_uvs_that_read_it(scene, out, tmp_path, change):
    obj = sheared()
    change(obj)
    bake_in_texture(tmp_path, [obj])
    gltf_export.write(str(out))
    glb = Glb(out)
    name = f"TEXCOORD_{glb.prt(obj.name)['texture']['texCoord']}"
    found = [np.concatenate([a["POSITION"], a[name]], axis=1) for a in glb.attributes(obj.name)]
    np.testing.assert_allclose(rows(np.concatenate(found)), rows(corners(obj)), atol=2e-5)
    assert not [key for a in glb.attributes(obj.name) for key in a if key.startswith("_PRT")]
    assert_valid(out)


def test_objects_of_one_atlas_share_its_pictures(scene, out, tmp_path):
    objects = [monkey("First"), rotated()]
    bake_in_texture(tmp_path, objects)
    gltf_export.write(str(out))
    glb = Glb(out)
    first, second = (glb.prt(obj.name)["texture"]["images"] for obj in objects)
    assert first == second == list(range(4))
    assert len(glb.document["images"]) == 4
    assert "textures" not in glb.document
    assert all(image["mimeType"] == "image/png" for image in glb.document["images"])


@pytest.mark.parametrize("share", [0.0, 2.5])
def test_a_residual_of_another_light_is_scaled_or_left_out(scene, out, tmp_path, share):
    first, second = monkey("First"), monkey("Second")
    layout = Layout(3, turns=1, lights=1)
    values = bake_in_texture(tmp_path, [first, second], layout)
    stamp.set_share(second, share)
    gltf_export.write(str(out))
    glb = Glb(out)
    slots = glb.prt("Second")["layout"]
    if not share:
        assert not {"R0r", "S0"} & set(slots)
    else:
        found = glb.atlas("Second")[..., slots.index("R0g")]
        np.testing.assert_allclose(found, share * values[::-1, :, 10], atol=1e-4)
        np.testing.assert_allclose(
            glb.atlas("Second")[..., slots.index("S0")], values[::-1, :, 12], atol=1e-4
        )
    assert "R0g" in glb.prt("First")["layout"]
    assert_valid(out)


def texcoords(glb, name):
    return sorted(key for key in glb.attributes(name)[0] if key.startswith("TEXCOORD"))


def leave_out(obj):
    obj.location.x += 3
    stamp.switch(obj, on=False)


def forget_image(obj):
    bpy.data.images.remove(stamp.image_of(obj))


@pytest.mark.parametrize("why", [leave_out, forget_image])
@pytest.mark.parametrize("subdivided", [False, True])
def test_a_bake_left_out_leaves_no_uv_map_behind(scene, tmp_path, capfd, why, subdivided):
    obj, out = monkey(), tmp_path / "scene.glb"
    if subdivided:
        obj.modifiers.new("Subdivision", "SUBSURF")
    before = export(out, export_apply=True)
    bake_in_texture(tmp_path, [obj])
    why(obj)
    after = export(out, export_apply=True)
    assert after.prt("Monkey") is None
    assert "Left out the bake of Monkey" in capfd.readouterr().out
    assert texcoords(after, "Monkey") == texcoords(before, "Monkey") == ["TEXCOORD_0"]
    assert "images" not in after.document


def test_an_unbaked_object_of_the_same_mesh_gains_no_uv_map(scene, out, tmp_path):
    """The baked one carries its map by a modifier."""
    first = monkey("First")
    second = first.copy()
    second.name = "Second"
    scene.collection.objects.link(second)
    bake_in_texture(tmp_path, [first])
    glb = export(out)
    assert glb.prt("Second") is None
    assert texcoords(glb, "Second") == ["TEXCOORD_0"]
    assert texcoords(glb, "First") == ["TEXCOORD_0", "TEXCOORD_1"]


def test_a_map_that_the_artist_made_stays_his(scene, out, tmp_path):
    """It is called PRT too, and lies where he put it."""
    obj = monkey()
    layer = obj.data.uv_layers.new(name=uv_maps.NAME)
    layer.uv.foreach_set("vector", np.random.default_rng(0).uniform(size=2 * len(layer.uv)))
    before = export(out)
    bake_in_texture(tmp_path, [obj], own_uvs=True)
    assert export(out).prt("Monkey")["texture"]["texCoord"] == 1
    leave_out(obj)
    after = export(out)
    assert texcoords(after, "Monkey") == texcoords(before, "Monkey")


def test_maps_after_ours_keep_their_numbers(scene, out, tmp_path):
    """The artist's materials know them by these."""
    obj = monkey()
    bake_in_texture(tmp_path, [obj])
    obj.data.uv_layers.new(name="Later")
    assert export(out).prt("Monkey")["texture"]["texCoord"] == 1
    leave_out(obj)
    assert texcoords(export(out), "Monkey") == [f"TEXCOORD_{k}" for k in range(3)]


def test_without_uvs_it_is_left_out_with_a_word(scene, out, tmp_path, capfd):
    bake_in_texture(tmp_path, [monkey()])
    glb = export(out, export_texcoords=False)
    assert glb.prt("Monkey") is None
    assert "textures need UVs, switch them on" in capfd.readouterr().out
    assert texcoords(glb, "Monkey") == []
