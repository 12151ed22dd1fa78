"""What the artist has and chose is in the file as it would be without a bake."""

import bpy
import numpy as np
import pytest
from glb import Glb
from gltf_laws import assert_same_light, element_values
from gltf_scenes import COLORS, colored, export, monkey, paint, sheared
from prt_baker.addon import gltf_export, stamp


def test_only_baked_objects_get_transfer_though_they_share_a_mesh(scene, bake, out):
    baked = monkey("Baked")
    copied = baked.copy()
    copied.name = "Unbaked"
    scene.collection.objects.link(copied)
    transfer = bake(baked)
    monkey("Other").modifiers.new("Subdivision", "SUBSURF")
    gltf_export.write(str(out))
    glb = Glb(out)
    assert_same_light(glb, "Baked", transfer, glb.world("Baked"), np.eye(3))
    for name in ("Unbaked", "Other"):
        assert glb.prt(name) is None
        assert not [key for a in glb.attributes(name) for key in a if key.startswith("_")]
    bare, dressed = glb.mesh("Unbaked")["primitives"][0], glb.mesh("Baked")["primitives"][0]
    assert bare["attributes"]["POSITION"] == dressed["attributes"]["POSITION"], "written twice"
    plain_cage = len(glb.attributes("Unbaked")[0]["POSITION"])
    assert len(glb.attributes("Other")[0]["POSITION"]) == plain_cage, "the artist applied nothing"


def test_a_stale_bake_is_left_out_and_named(scene, bake, out, capfd):
    for name in ("Fresh", "Stale"):
        bake(monkey(name))
    bpy.data.objects["Stale"].location.x = 3
    stamp.switch(bpy.data.objects["Stale"], on=False)
    gltf_export.write(str(out))
    glb = Glb(out)
    assert glb.prt("Fresh")
    assert glb.prt("Stale") is None
    (attributes,) = glb.attributes("Stale")
    assert {"POSITION", "NORMAL", "TEXCOORD_0"} == set(attributes)
    assert "Left out the bake of Stale" in capfd.readouterr().out


def without_order(attributes):
    """The vertices of a primitive as sorted rows, once each: a bake may split vertices."""
    names = sorted(name for name in attributes if not name.startswith("_PRT"))
    rows = np.concatenate([attributes[name].astype(np.float64) for name in names], axis=1)
    return names, np.unique(rows, axis=0)


OPTIONS = [
    ("POINT", {}),
    ("CORNER", {}),
    ("POINT", {"export_vertex_color": "ACTIVE"}),
    ("CORNER", {"export_vertex_color": "NONE"}),
    ("POINT", {"export_vertex_color": "NAME", "export_vertex_color_name": "Dirt"}),
    ("CORNER", {"export_all_vertex_colors": False}),
    ("POINT", {"export_materials": "NONE"}),
    ("CORNER", {"export_attributes": True, "export_extras": True}),
    ("POINT", {"export_shared_accessors": True}),
    ("CORNER", {"export_tangents": True, "use_mesh_edges": True, "use_mesh_vertices": True}),
]


@pytest.mark.parametrize(("domain", "options"), OPTIONS, ids=str)
@pytest.mark.parametrize("reading", [None, "Paint", "Dirt", "", "no color", "no material"])
def test_everything_else_is_what_it_would_be_without_a_bake(
    bake, tmp_path, options, reading, domain
):
    if reading == "no material" and "export_all_vertex_colors" in options:
        pytest.skip("loses COLOR_0, see gltf_colors")
    obj = colored([], "") if reading == "no color" else colored(COLORS, reading)
    before = export(tmp_path / "before.glb", **options)
    bake(obj, domain=domain)
    after = export(tmp_path / "after.glb", **options)
    assert after.prt(obj.name)
    assert_same_but_for_transfer(before, after, obj.name)


def assert_same_but_for_transfer(before, after, name):
    for was, now in zip(before.attributes(name), after.attributes(name), strict=True):
        (names, rows), (names_now, rows_now) = without_order(was), without_order(now)
        assert names == names_now
        np.testing.assert_array_equal(rows, rows_now)
    for key in ("materials", "nodes", "images", "textures"):
        assert before.document.get(key) == after.document.get(key)


@pytest.mark.parametrize("reading", ["Paint", "Dirt"])
@pytest.mark.parametrize("domain", ["POINT", "CORNER"])
def test_colors_made_before_and_after_the_bake_are_told_apart(bake, tmp_path, reading, domain):
    colors = [("Paint", "FLOAT_COLOR", domain), ("Dirt", "FLOAT_COLOR", domain)]
    obj = colored(colors, reading)
    before = export(tmp_path / "before.glb")
    obj.data.attributes.remove(obj.data.attributes["Dirt"])
    bake(obj, domain=domain)
    paint(obj.data, *colors[1])
    after = export(tmp_path / "after.glb")
    assert_same_but_for_transfer(before, after, obj.name)


def test_attributes_of_the_artist_come_only_when_he_wants_them(scene, bake, tmp_path):
    obj = monkey()
    obj.data.attributes.new("_mine", "FLOAT", "POINT")
    bake(obj)
    for wanted in (False, True):
        glb = export(tmp_path / f"{wanted}.glb", export_attributes=wanted)
        (attributes,) = glb.attributes(obj.name)
        assert ("_MINE" in attributes) == wanted
        assert glb.prt(obj.name)


@pytest.mark.parametrize(
    "options",
    [
        {"use_selection": True},
        {"use_visible": True, "use_renderable": True},
        {"use_active_collection": True},
        {"export_hierarchy_full_collections": True},
        {"export_hierarchy_flatten_objs": True},
        {"collection": "Part"},
        {"export_gpu_instances": True},
        {"use_active_scene": True},
        {"export_yup": False},
        {"export_apply": True, "export_extras": True},
    ],
    ids=str,
)
def test_parts_instances_and_several_scenes(scene, bake, tmp_path, options):
    part = bpy.data.collections.new("Part")
    scene.collection.children.link(part)
    obj = sheared()
    part.objects.link(obj)
    part.objects.link(obj.parent)
    empty = bpy.data.objects.new("Instance", None)
    empty.instance_type, empty.instance_collection = "COLLECTION", part
    empty.location = (5, 5, 5)
    scene.collection.objects.link(empty)
    other = bpy.data.scenes.new("Other scene")
    other.collection.objects.link(monkey("Elsewhere"))
    transfer = bake(obj)
    obj.select_set(True)
    bpy.context.view_layer.objects.active = obj
    glb = export(tmp_path / "part.glb", **options)
    assert glb.prt(obj.name)
    lit = [s for s in glb.document["scenes"] if "extras" in s]
    assert [set(s["extras"]) for s in lit] == [{"prt_light"}], "the light of one scene, no settings"
    found, expected = element_values(glb, obj.name, transfer)
    matrix = np.reshape(glb.prt(obj.name)["matrix"], (3, 3)).T
    worlds = glb.worlds_of_mesh(glb.nodes[obj.name]["mesh"])
    assert min(np.abs(matrix - world).max() for world in worlds) < 1e-9
    if not options.get("export_yup", True):
        np.testing.assert_array_equal(found, expected)


def test_a_file_without_bakes_is_the_exporters_own(scene, tmp_path):
    monkey().data.attributes.new("_PRT_0", "FLOAT_COLOR", "POINT")
    bpy.ops.export_scene.gltf(filepath=str(tmp_path / "own.glb"), export_vertex_color="NONE")
    export(tmp_path / "ours.glb", export_vertex_color="NONE")
    own, ours = Glb(tmp_path / "own.glb"), Glb(tmp_path / "ours.glb")
    assert own.binary == ours.binary


def test_the_bake_adds_what_its_floats_weigh(scene, bake, tmp_path):
    obj = monkey()
    without = len(export(tmp_path / "without.glb").binary)
    bake(obj)
    glb = export(tmp_path / "with.glb")
    vertices = len(glb.transfer(obj.name))
    assert len(glb.binary) - without == vertices * 3 * 16
    assert (tmp_path / "with.glb").stat().st_size < (tmp_path / "without.glb").stat().st_size + (
        vertices * 48 + 8000
    )


def test_draco_leaves_bakes_out_and_says_so(scene, bake, out, capfd):
    """Draco rounds what it packs; a wheel without Draco exports as ever."""
    bake(monkey())
    glb = export(out, export_draco_mesh_compression_enable=True)
    packed = "KHR_draco_mesh_compression" in glb.document.get("extensionsUsed", [])
    assert (glb.prt("Monkey") is None) == packed
    assert ("Draco would round the bakes" in capfd.readouterr().out) == packed
