"""A bake in a .glb: a reader that knows glTF alone sees the light that the .blend shows."""

import json
import os
import resource
import shutil
import subprocess
import sys
from math import radians
from pathlib import Path

import bpy
import numpy as np
import pytest
from glb import Glb
from mathutils import Euler, Matrix
from prt_baker.addon import gltf_export, light_state, stamp
from prt_baker.addon.prt import sh
from prt_baker.addon.prt.errors import BakeError

HERE = Path(__file__).parent
Y_UP = np.array(Matrix(((1, 0, 0), (0, 0, 1), (0, -1, 0))))
TURN = np.array(Euler((0.3, -0.5, radians(40))).to_matrix())


@pytest.fixture
def out(tmp_path):
    return tmp_path / "scene.glb"


def monkey(name="Monkey", location=(0, 0, 0)):
    bpy.ops.mesh.primitive_monkey_add(location=location)
    obj = bpy.context.object
    obj.name = name
    return obj


def plain():
    return monkey()


def rotated():
    obj = monkey(location=(1, 2, 3))
    obj.rotation_euler = (0.4, 1.1, -2)
    return obj


def mirrored():
    obj = rotated()
    obj.scale = (-1, 2, 0.5)
    return obj


def sheared():
    """A turned child of a parent that is scaled unevenly."""
    parent = bpy.data.objects.new("Parent", None)
    bpy.context.collection.objects.link(parent)
    parent.scale, parent.rotation_euler = (1, 3, 0.5), (0.2, 0.3, 0.4)
    obj = mirrored()
    obj.parent = parent
    return obj


def sheared_by_itself():
    """Parented with its place kept: its own matrix is sheared, which no glTF node can hold."""
    obj = sheared()
    obj.matrix_parent_inverse = (
        Matrix.Diagonal((1, 4, 1, 1)) @ Euler((1, 1, 0)).to_matrix().to_4x4()
    )
    return obj


NODES = [plain, rotated, mirrored, sheared, sheared_by_itself]


def element_values(glb, name, transfer):
    """The file's transfer and the .blend's, of the same elements: T0 tells which, no turn changes
    it, and it is float32 in both."""
    found = glb.transfer(name)
    order = np.argsort(transfer[:, 0, 0])
    places = np.searchsorted(transfer[order, 0, 0], found[:, 0, 0])
    expected = transfer[order[places]]
    np.testing.assert_array_equal(found[..., 0], expected[..., 0])
    assert set(order[places]) == set(range(len(transfer))), "an element is missing in the file"
    return found, expected


def light_of(glb, order):
    extras = glb.document["scenes"][0]["extras"]["prt_light"]
    assert extras["lights"] == []
    assert extras["order"] == 5
    return np.array(extras["radiance_sh"])[: order**2]


def exit_radiance(transfer, light):
    """(E, 3) of a white surface."""
    return np.einsum("eci,ic->ec", np.broadcast_to(transfer, (len(transfer), 3, len(light))), light)


def assert_same_light(glb, name, transfer, now, turned):
    """``now``: the world 3x3 that a viewer gives the node; ``turned``: by how much the .blend's
    object is turned, Z up."""
    order = round(transfer.shape[-1] ** 0.5)
    state = light_state.read(bpy.context.scene).radiance_sh[: order**2]
    found, expected = element_values(glb, name, transfer)
    baked = np.reshape(glb.prt(name)["matrix"], (3, 3)).T
    delta = now @ np.linalg.inv(baked)
    np.testing.assert_allclose(delta @ delta.T, np.eye(3), atol=1e-5)
    seen = exit_radiance(found, sh.rotate(light_of(glb, order), delta.T))
    truth = exit_radiance(expected, sh.rotate(state, turned.T))
    np.testing.assert_allclose(seen, truth, atol=1e-5)


@pytest.mark.parametrize("make", NODES)
@pytest.mark.parametrize("domain", ["POINT", "CORNER"])
def test_a_node_shows_the_light_of_the_blend_standing_and_turned(scene, bake, out, make, domain):
    name = make().name
    transfer = bake(bpy.data.objects[name], domain=domain)
    gltf_export.write(str(out), [name])
    glb = Glb(out)
    world = glb.world(name)
    assert_same_light(glb, name, transfer, world, np.eye(3))
    assert_same_light(glb, name, transfer, Y_UP @ TURN @ Y_UP.T @ world, TURN)


@pytest.mark.parametrize("make", NODES)
def test_an_unmoved_node_needs_no_turn(scene, bake, out, make):
    obj = make()
    bake(obj)
    gltf_export.write(str(out))
    glb = Glb(out)
    matrix = np.reshape(glb.prt(obj.name)["matrix"], (3, 3)).T
    np.testing.assert_allclose(matrix, glb.world(obj.name), atol=1e-9)


@pytest.mark.parametrize("make", [plain, rotated, mirrored, sheared])
def test_matrix_is_that_of_the_bake_in_the_frame_of_gltf(scene, bake, out, make):
    obj = make()
    bake(obj)
    gltf_export.write(str(out))
    matrix = np.reshape(Glb(out).prt(obj.name)["matrix"], (3, 3)).T
    blender = np.array(obj.matrix_world.to_3x3())
    np.testing.assert_allclose(matrix, Y_UP @ blender @ Y_UP.T, atol=1e-5)


@pytest.mark.parametrize(("order", "channels"), [(2, 1), (5, 1), (2, 3), (4, 3)])
def test_every_layout_arrives(scene, bake, out, order, channels):
    obj = mirrored()
    transfer = bake(obj, order=order, channels=channels, residual=True)
    gltf_export.write(str(out))
    glb = Glb(out)
    assert_same_light(glb, obj.name, transfer, glb.world(obj.name), np.eye(3))
    prt = glb.prt(obj.name)
    assert (prt["version"], prt["frame"], prt["scale"]) == (1, "world", 1)
    (attributes,) = glb.attributes(obj.name)
    rest = np.concatenate([attributes[f"_PRT_{k}"] for k in range(len(prt["layout"]) // 4)], 1)
    assert (rest[:, prt["layout"].index("R0r") :] == 7).all(), "the residual was turned"


def test_modifiers_and_shared_meshes_arrive_each_with_its_own(scene, bake, out):
    first = monkey("First")
    first.modifiers.new("Subdivision", "SUBSURF")
    second = first.copy()
    second.name, second.location = "Second", (3, 0, 0)
    third = monkey("Third")
    third.data = first.data
    for obj in (second, third):
        if obj.name not in scene.objects:
            scene.collection.objects.link(obj)
    second.modifiers["Subdivision"].levels = 2
    baked = {obj.name: bake(obj, by_modifier=True) for obj in (first, second, third)}
    gltf_export.write(str(out), list(baked))
    glb = Glb(out)
    assert len({glb.nodes[name]["mesh"] for name in baked}) == 3
    for name, transfer in baked.items():
        assert_same_light(glb, name, transfer, glb.world(name), np.eye(3))


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
    stamp.switch(bpy.data.objects["Stale"], on=False)
    gltf_export.write(str(out))
    glb = Glb(out)
    assert glb.prt("Fresh")
    assert glb.prt("Stale") is None
    (attributes,) = glb.attributes("Stale")
    assert {"POSITION", "NORMAL", "TEXCOORD_0"} == set(attributes)
    assert "Left out the bake of Stale" in capfd.readouterr().out


def test_an_object_moved_before_it_was_found_stale_says_where_it_was_baked(scene, bake, out):
    obj = rotated()
    transfer = bake(obj)
    before = np.array(obj.matrix_world.to_3x3())
    obj.rotation_euler.rotate_axis("Z", radians(70))
    bpy.context.view_layer.update()
    stamp.switch(obj, on=True)
    gltf_export.write(str(out))
    glb = Glb(out)
    turned = np.array(obj.matrix_world.to_3x3()) @ np.linalg.inv(before)
    assert_same_light(glb, obj.name, transfer, glb.world(obj.name), turned)


def paint(mesh, name, kind, domain):
    attribute = mesh.color_attributes.new(name, kind, domain)
    values = np.random.default_rng(len(name)).uniform(size=(len(attribute.data), 4))
    attribute.data.foreach_set("color", values.astype(np.float32).ravel())


def colored(colors, reading=None):
    """One object with colour attributes and two materials; the first reads ``reading``."""
    obj = monkey()
    for color in colors:
        paint(obj.data, *color)
    for name in ("One", "Two") if reading != "no material" else ():
        material = bpy.data.materials.new(name)
        if bpy.app.version < (5, 0):
            material.use_nodes = True
        obj.data.materials.append(material)
    if reading in (*[color[0] for color in colors], ""):
        nodes = obj.data.materials["One"].node_tree.nodes
        node = nodes.new("ShaderNodeVertexColor")
        node.layer_name = reading
        principled = next(n for n in nodes if n.type == "BSDF_PRINCIPLED")
        obj.data.materials["One"].node_tree.links.new(
            node.outputs["Color"], principled.inputs["Base Color"]
        )
    for polygon in list(obj.data.polygons)[::2]:
        polygon.material_index = 1
    obj["artist"] = 1
    return obj


def export(path, **options):
    """File > Export, as an artist may set it."""
    with gltf_export._found_by_the_exporter():
        bpy.ops.export_scene.gltf(filepath=str(path), export_format="GLB", **options)
    return Glb(path)


def without_order(attributes):
    """The vertices of a primitive as sorted rows, once each: a bake may split vertices."""
    names = sorted(name for name in attributes if not name.startswith("_PRT"))
    rows = np.concatenate([attributes[name].astype(np.float64) for name in names], axis=1)
    return names, np.unique(rows, axis=0)


COLORS = [("Paint", "BYTE_COLOR", "CORNER"), ("Dirt", "FLOAT_COLOR", "POINT")]
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


def test_nan_becomes_zero(scene, bake, out):
    obj = monkey()
    bake(obj)
    obj.data.attributes["_PRT_1"].data[3].color = (np.nan, np.inf, -np.inf, 1)
    gltf_export.write(str(out))
    assert np.isfinite(Glb(out).transfer(obj.name)).all()
    assert_valid(out)


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


def node_program():
    """node: $NODE, that of this environment, or that on PATH."""
    beside = shutil.which("node", path=str(Path(sys.executable).parent))
    return os.environ.get("NODE") or beside or shutil.which("node")


def assert_valid(path):
    """No error, and no warning, says gltf-validator."""
    program = node_program()
    assert program, "gltf-validator needs node: make test installs it"
    run = subprocess.run(
        [program, str(HERE / "validate.mjs"), str(path)], capture_output=True, text=True, check=True
    )
    issues = json.loads(run.stdout)
    assert issues["numErrors"] == issues["numWarnings"] == 0, issues["messages"]


def test_gltf_validator_finds_no_error(scene, bake, out):
    bake(sheared(), channels=3, residual=True)
    bake(monkey("Corner"), domain="CORNER")
    subdivided = monkey("Subdivided")
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


def test_draco_leaves_bakes_out_and_says_so(scene, bake, out, capfd):
    """Draco rounds what it packs; a wheel without Draco exports as ever."""
    bake(monkey())
    glb = export(out, export_draco_mesh_compression_enable=True)
    packed = "KHR_draco_mesh_compression" in glb.document.get("extensionsUsed", [])
    assert (glb.prt("Monkey") is None) == packed
    assert ("Draco would round the bakes" in capfd.readouterr().out) == packed


def test_an_animated_object_says_where_it_was_baked(scene, bake, out):
    """Without Use Current Frame the exporter writes nodes as they stand at frame 0."""
    obj = monkey()
    for frame, angle in ((0, 0), (20, 1.5)):
        obj.rotation_euler.z = angle
        obj.keyframe_insert("rotation_euler", frame=frame)
    scene.frame_set(20)
    transfer = bake(obj)
    glb = export(out)
    np.testing.assert_allclose(glb.world(obj.name), np.eye(3))
    back = np.array(Euler((0, 0, -1.5)).to_matrix())
    assert_same_light(glb, obj.name, transfer, glb.world(obj.name), back)


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
