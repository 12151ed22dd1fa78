"""Light without bounces in glTF: its numbers are those of the .blend, it comes back, and what is
wrong with it is named."""

from dataclasses import replace

import bpy
import numpy as np
import pytest
from glb import Glb
from glb_edit import of_mesh, rewritten
from gltf_laws import SHORT, Y_UP, stated_errors
from gltf_scenes import mirrored, monkey, rotated, sheared
from gltf_textured import bake_in_texture
from gltf_validator import assert_valid
from prt_baker.addon import (
    atlas_images,
    attributes,
    carrier,
    gltf,
    gltf_export,
    gltf_panel,
    remove,
    stamp,
)
from prt_baker.addon.prt import layout as layouts
from prt_baker.addon.prt import sh
from prt_baker.addon.prt.layout import Layout
from scipy.spatial import cKDTree
from test_gltf_import import imported, matched
from test_viewer import LOOK

T9 = [f"T{i}" for i in range(9)]
RESIDUAL = ["R0r", "R0g", "R0b"]


def stored(obj):
    """What the elements of ``obj`` hold without bounces, as it is shown."""
    made = stamp.read(obj)
    names = made.packing.direct.called("_PRT_DIRECT_")
    with carrier.evaluated_mesh(obj, bpy.context.evaluated_depsgraph_get()) as mesh:
        columns = [attributes._values(mesh, name) for name in names]
    return layouts.unpack(made.packing.direct, np.concatenate(columns, axis=1))


def subdivided():
    obj = mirrored()
    obj.modifiers.new("Subdivision", "SUBSURF").levels = 1
    return obj


MAKERS = {"corners": (sheared, {"domain": "CORNER"}), "modifier": (subdivided, {})}


@pytest.mark.parametrize("short", [False, True], ids=["float", "short"])
@pytest.mark.parametrize("kind", MAKERS)
@pytest.mark.usefixtures("registered")
def test_its_numbers_are_those_of_the_blend(scene, bake, out, kind, short):
    make, options = MAKERS[kind]
    obj = make()
    bake(obj, channels=3, turns=2, lights=2, by_modifier=kind == "modifier", direct=True, **options)
    with gltf_panel.chosen(scene, short):
        gltf_export.write(str(out))
    assert_valid(out)
    glb, truth = Glb(out), stored(obj)
    prt = glb.prt(obj.name)
    assert prt["includes"] == "visibility, cosine / pi, bounces"
    slots = [*T9, *RESIDUAL, "R1r", "R1g", "R1b", "S0", "S1"]
    assert [slot for slot in prt["direct"]["layout"] if slot] == slots
    found = glb.slots(obj.name, slots, direct=True)
    transfer = truth.transfer[:, 0] @ sh.rotation_matrix(Y_UP, 3).T
    rows = np.concatenate(
        [transfer, truth.residual.reshape(len(transfer), -1), truth.visibility], axis=1
    )
    off = np.abs(found - rows[cKDTree(rows).query(found)[1]])
    assert cKDTree(found).query(rows)[0].max() < 1e-3
    scale = np.array(prt["direct"]["scale"])[: len(slots)] if short else 0
    assert (off <= 2e-6 + scale / SHORT * 1.01).all()
    assert short == (off.max() > 1e-5)


def test_a_bake_without_it_says_nothing_of_it(scene, bake, out):
    bake(monkey(), channels=3, turns=1)
    gltf_export.write(str(out))
    assert "direct" not in Glb(out).prt("Monkey")
    assert not any("DIRECT" in name for name in Glb(out).attributes("Monkey")[0])


def test_under_another_light_it_comes_without_its_residual_too(scene, bake, out):
    obj = monkey()
    bake(obj, channels=3, turns=1, lights=1, direct=True)
    stamp.set_share(obj, 0.0)
    gltf_export.write(str(out))
    assert_valid(out)
    assert [slot for slot in Glb(out).prt("Monkey")["direct"]["layout"] if slot] == T9


def test_where_it_was_taken_away_the_rest_goes_out(scene, bake, out):
    obj = monkey()
    bake(obj, turns=1, direct=True)
    obj.data.attributes.remove(obj.data.attributes["_PRT_DIRECT_1"])
    gltf_export.write(str(out))
    assert_valid(out)
    assert "direct" not in Glb(out).prt("Monkey")
    assert not any("DIRECT" in name for name in Glb(out).attributes("Monkey")[0])


def test_in_clusters_it_is_within_the_error_too(registered, scene, bake, out):
    obj = subdivided()
    bake(obj, turns=1, by_modifier=True, smooth=True, bent=True, direct=True)
    found = []
    for error in (None, 0.01):
        with gltf_panel.chosen(scene, None, error):
            gltf_export.write(str(out))
        assert_valid(out)
        found.append(Glb(out))
    direct = found[1].prt(obj.name)["direct"]
    assert direct["clusters"]["error"] <= 0.01
    assert [entry["direct"] for entry in gltf.REPORT] == [False, True]
    light = np.array(found[0].document["scenes"][0]["extras"]["prt_light"]["baked_radiance_sh"])
    seen = [
        glb.slots(obj.name, T9, direct=True) @ light[:9]
        + glb.slots(obj.name, RESIDUAL, direct=True)
        for glb in found
    ]
    off = np.sqrt(np.square(seen[1] - seen[0]).mean() / np.square(seen[0]).mean())
    assert 0 < off <= 0.0101


@pytest.mark.parametrize("short", [False, True], ids=["float", "short"])
@pytest.mark.parametrize("make", [rotated, sheared])
@pytest.mark.usefixtures("registered")
def test_it_comes_back_and_is_written_again(scene, bake, out, make, short):
    bake(make(), channels=3, turns=1, lights=1, direct=True)
    slots = [*T9, *RESIDUAL, "S0"]
    with gltf_panel.chosen(scene, short):
        gltf_export.write(str(out))
    first = Glb(out)
    scene = imported(out)
    obj = bpy.data.objects["Monkey"]
    assert stamp.read(obj).direct
    assert obj.get(stamp.SWITCH) == 1.0
    gltf_export.write(str(out))
    assert_valid(out)
    rows = [np.unique(glb.slots("Monkey", slots, direct=True), axis=0) for glb in (first, Glb(out))]
    assert rows[0].shape == rows[1].shape
    np.testing.assert_allclose(rows[1], rows[0], atol=2e-5 if short else 1e-5)
    remove.remove(scene, [obj])
    assert not attributes.names(obj.data)


def test_a_node_that_was_turned_since_has_it_turned(scene, bake, out):
    """Like the whole: the light of a first band turns as a vector does."""
    bake(monkey(), turns=1, direct=True)
    gltf_export.write(str(out))
    before = Glb(out).slots("Monkey", ["T0", "T1", "T2", "T3"], direct=True)

    def turned(document):
        document["nodes"][0]["rotation"] = [0, np.sqrt(0.5), 0, np.sqrt(0.5)]

    rewritten(out, turned)
    imported(out)
    found = stored(bpy.data.objects["Monkey"])
    assert found.residual.shape[1] == 0
    quarter = np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]]) @ Y_UP.T
    expected = before @ sh.rotation_matrix(quarter, 2).T
    np.testing.assert_allclose(matched(found.transfer[:, 0, :4], expected), expected, atol=1e-5)


MALFORMED = {
    "direct says nothing": lambda direct: 7,
    "layout has no T8": lambda direct: direct | {"layout": [*T9[:8], "", *RESIDUAL]},
    "scale is neither 1 nor 12 numbers": lambda direct: direct | {"scale": [1]},
    "direct has another layout than without bounces": lambda direct: (
        direct | {"layout": [*T9, "", "", ""]}
    ),
}


@pytest.mark.parametrize("sentence", MALFORMED)
def test_what_is_malformed_is_named_by_both_readers(  # noqa: PLR0917 - fixtures
    scene, bake, out, page, capfd, sentence
):
    bake(monkey(), turns=1, direct=True)
    gltf_export.write(str(out))
    wrong = MALFORMED[sentence](Glb(out).prt("Monkey")["direct"])
    rewritten(out, of_mesh(direct=wrong))
    said = page.run(LOOK, glb=out)
    assert said["plain"]
    if sentence != "direct says nothing":
        assert sentence in said["problems"][0]
    if "another layout" not in sentence:  # which a schema cannot compare
        with pytest.raises(AssertionError, match="/extras/prt"):
            assert_valid(out)
    assert not stamp.baked_objects(imported(out))
    assert f"comes without its bake: {sentence}" in capfd.readouterr().out


def test_without_bounces_there_is_nothing_to_leave_out(scene, bake, out, page, capfd):
    bake(monkey(), turns=1, direct=True)
    gltf_export.write(str(out))
    rewritten(out, of_mesh(includes="visibility, cosine / pi"))
    sentence = "it has direct light apart, and no bounces"
    assert sentence in page.run(LOOK, glb=out)["problems"][0]
    with pytest.raises(AssertionError, match="/extras/prt"):
        assert_valid(out)
    imported(out)
    assert sentence in capfd.readouterr().out


@pytest.mark.usefixtures("registered")
def test_in_pictures_it_has_some_of_its_own_and_comes_back(scene, out, tmp_path):
    first, second = rotated(), monkey("Second")
    second.location.x = 4
    layout = Layout(3, channels=3, turns=1, lights=1)
    bake_in_texture(tmp_path, [first, second], layout, direct=True)
    truth = atlas_images.columns(atlas_images.both(stamp.image_of(first))[1], 4)
    gltf_export.write(str(out))
    assert_valid(out)
    glb = Glb(out)
    whole, direct = (glb.prt("Monkey")[key] for key in ("texture", "direct"))
    assert glb.prt("Second")["direct"]["texture"] == direct["texture"]
    assert not set(whole["images"]) & set(direct["texture"]["images"])
    assert direct["layout"][:13] == [*T9, *RESIDUAL, "S0"]
    found = glb.atlas("Monkey", direct=True)[::-1, :, :13]
    expected = truth[..., :13].copy()
    expected[..., :9] = expected[..., :9] @ sh.rotation_matrix(Y_UP, 3).T
    step = np.array(direct["scale"])[:13] / 131070
    assert (np.abs(found - expected) <= 1.01 * step + 1e-6).all()
    imported(out)
    image = stamp.image_of(bpy.data.objects["Monkey"])
    assert stamp.read(bpy.data.objects["Monkey"]).direct
    assert image == stamp.image_of(bpy.data.objects["Second"])
    (_, again) = atlas_images.both(image)
    errors = stated_errors(direct, [*T9, *RESIDUAL, "S0"], 131070)
    off = np.abs(atlas_images.columns(again, 4)[..., :13] - truth[..., :13])
    assert (off <= 1.01 * errors + 1e-6).all()


def test_pictures_of_another_bake_are_left_out(scene, out, tmp_path):
    """The file was written over since, by a bake of another .blend."""
    obj = monkey()
    bake_in_texture(tmp_path, [obj], direct=True)
    (_, direct) = atlas_images.both(stamp.image_of(obj))
    direct[atlas_images.TAG] = direct[atlas_images.TAG].replace('"test"', '"another"')
    gltf_export.write(str(out))
    assert_valid(out)
    assert "direct" not in Glb(out).prt("Monkey")
    assert "texture" in Glb(out).prt("Monkey")


def test_a_stamp_of_before_has_none(scene, bake):
    obj = monkey()
    bake(obj, turns=1)
    assert list(stamp.read(obj).sets) == ["_PRT_"]
    stamp.write(obj, replace(stamp.read(obj), direct=True))
    assert list(stamp.read(obj).sets) == ["_PRT_", "_PRT_DIRECT_"]
