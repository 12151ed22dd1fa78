"""File > Import > glTF brings bakes back: attributes, stamps, materials and light."""

import bpy
import numpy as np
import pytest
from glb import Glb
from glb_edit import of_mesh, of_scene, rewritten
from gltf_laws import SHORT, Y_UP, stated_errors
from gltf_scenes import BAKED, monkey, plain, rotated, sheared
from mathutils import Euler
from prt_baker.addon import (
    attributes,
    gltf_export,
    gltf_panel,
    light_state,
    materials,
    nodes,
    remove,
    stale,
    stamp,
)
from prt_baker.addon.prt import sh
from scipy.spatial import cKDTree


def imported(path, **options):
    """The scene of an empty file into which ``path`` came; what Blender said is on stdout."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    return added(path, **options)


def added(path, **options):
    """The scene, with ``path`` in it."""
    with gltf_export._found_by_the_exporter():
        bpy.ops.import_scene.gltf(filepath=str(path), **options)
    bpy.context.view_layer.update()
    return bpy.context.scene


def held(scene):
    """What every baked object of ``scene`` holds, by name: order, and a row of transfer, residual
    and visibility for each corner of a triangle."""
    found = {}
    for obj in stamp.baked_objects(scene):
        mark = stamp.read(obj)
        values = attributes.read(obj, mark)
        evaluated = obj.evaluated_get(bpy.context.evaluated_depsgraph_get()).to_mesh()
        evaluated.calc_loop_triangles()
        ends = "vertices" if mark.domain == "POINT" else "loops"
        corners = np.array([getattr(t, ends)[:] for t in evaluated.loop_triangles]).ravel()
        count = len(values.transfer)
        parts = (values.transfer, values.residual, values.visibility, values.visibility_sh)
        rows = np.concatenate([part.reshape(count, -1) for part in parts], axis=1)[corners]
        found[obj.name] = mark.order, rows
    return found


@pytest.mark.parametrize("short", [False, True], ids=["float", "short"])
@pytest.mark.parametrize("make", BAKED.values(), ids=BAKED)
@pytest.mark.usefixtures("registered")
def test_a_round_trip_keeps_every_value(scene, bake, out, make, short):
    make(bake)
    before, light = held(scene), light_state.read(scene)
    with gltf_panel.chosen(scene, short):
        gltf_export.write(str(out))
    stated = {name: within(Glb(out).prt(name), short) for name in before}
    scene = imported(out)
    after = held(scene)
    assert set(before) == set(after)
    for name, (order, rows) in before.items():
        assert after[name][0] == order
        off = np.abs(matched(after[name][1], rows) - rows)
        assert (off <= 1e-6 * np.maximum(1, abs(rows).max(0)) + stated[name]).all()
        assert not short or off.max() > 0.5 * stated[name].max(), "not quantized"
        assert bpy.data.objects[name].get(stamp.SWITCH) == 1.0
        assert stamp.share(bpy.data.objects[name]) == 1.0
    found = light_state.read(scene)
    np.testing.assert_allclose(found.radiance_sh, light.radiance_sh, atol=1e-6)
    np.testing.assert_allclose(found.baked_radiance_sh, light.baked_radiance_sh, atol=1e-6)
    for ours, theirs in zip(found.peaks, light.peaks, strict=True):
        np.testing.assert_allclose(ours.direction, theirs.direction, atol=1e-6)
        assert ours.irradiance == theirs.irradiance
        assert ours.angular_radius == theirs.angular_radius


def within(prt, short):
    """How far every number of a row may be from what it was."""
    used = [slot for slot in prt["layout"] if slot]
    transfer = [slot for slot in used if slot[0] == "T"]
    rows = [slot for c in range(prt["channels"]) for slot in transfer[c :: prt["channels"]]]
    rows += used[len(transfer) :]
    return stated_errors(prt, rows, SHORT) if short else np.zeros(len(rows))


def matched(found, rows):
    """The rows of ``found`` that are nearest to ``rows``, each of which is near one: the elements
    of these made-up bakes are far from each other."""
    distances, _ = cKDTree(rows).query(found)
    assert distances.max() < 1e-2
    return found[cKDTree(found).query(rows)[1]]


def test_what_came_in_is_written_as_it_came(scene, bake, out, tmp_path):
    bake(sheared(), turns=1, lights=2, order=5)
    gltf_export.write(str(out))
    first, name = Glb(out), "Monkey"
    imported(out)
    gltf_export.write(str(out))
    second = Glb(out)
    slots = [slot for slot in first.prt(name)["layout"] if slot]
    np.testing.assert_allclose(
        matched(second.slots(name, slots), first.slots(name, slots)),
        first.slots(name, slots),
        atol=1e-5,
    )
    np.testing.assert_allclose(second.prt(name)["matrix"], first.prt(name)["matrix"], atol=1e-6)
    lights = [glb.document["scenes"][0]["extras"]["prt_light"] for glb in (first, second)]
    for key in ("radiance_sh", "baked_radiance_sh"):
        np.testing.assert_allclose(lights[0][key], lights[1][key], atol=1e-9)


def test_eevee_shows_it(registered, scene, bake, out):
    """The material switches on the object's mark, and the group holds the file's light."""
    bake(monkey(), turns=1)
    light = light_state.read(scene)
    gltf_export.write(str(out))
    imported(out)
    (slot,) = bpy.data.objects["Monkey"].material_slots
    assert materials.layout_of(slot.material) == stamp.read(bpy.data.objects["Monkey"]).packing
    (group,) = nodes.groups()
    shown = [group.nodes[f"L{i}"].inputs[1].default_value[:] for i in range(9)]
    np.testing.assert_allclose(shown, light.radiance_sh[:9], atol=1e-6)


def test_no_extras_of_ours_are_left_and_none_is_taken_over(scene, bake, out):
    bake(monkey())
    gltf_export.write(str(out))
    scene = imported(out)
    assert isinstance(scene[light_state.KEY], str)
    assert "prt" not in bpy.data.objects["Monkey"].data
    stale.refresh(scene)
    assert bpy.data.objects["Monkey"][stamp.SWITCH] == 1.0
    assert not light_state.read(scene).follows, "it is not the light of this scene's world"


def test_it_can_be_removed_as_any_bake(registered, scene, bake, out):
    bake(monkey())
    gltf_export.write(str(out))
    scene = imported(out)
    remove.remove(scene, [bpy.data.objects["Monkey"]])
    assert not attributes.names(bpy.data.objects["Monkey"].data)
    assert light_state.read(scene) is None


@pytest.mark.parametrize("merge", [False, True])
def test_merged_vertices_keep_their_values(scene, bake, out, merge):
    bake(monkey(), domain="CORNER", turns=1)
    before = held(scene)["Monkey"][1]
    gltf_export.write(str(out))
    after = held(imported(out, merge_vertices=merge))["Monkey"][1]
    np.testing.assert_allclose(matched(after, before), before, atol=1e-5)


def turned_in_file(path, name, quaternion):
    """Turn a node, as another program would."""

    def change(document):
        node = next(n for n in document["nodes"] if n["name"] == name)
        node["rotation"] = quaternion

    rewritten(path, change)


def test_a_node_that_was_turned_since_shows_the_turned_transfer(scene, bake, out):
    transfer = bake(plain(), turns=1)
    gltf_export.write(str(out))
    turned_in_file(out, "Monkey", [0, np.sin(0.5), 0, np.cos(0.5)])
    scene = imported(out)
    obj = bpy.data.objects["Monkey"]
    _, rows = held(scene)["Monkey"]
    turn = np.array(obj.matrix_world.to_3x3(), np.float64)
    np.testing.assert_allclose(turn, Euler((0, 0, 1)).to_matrix(), atol=1e-6)
    expected = transfer[:, 0].astype(float) @ sh.rotation_matrix(turn, 3).T
    places = np.searchsorted(np.sort(transfer[:, 0, 0]), rows[:, 0])
    expected = expected[np.argsort(transfer[:, 0, 0])][places]
    np.testing.assert_allclose(rows[:, :9], expected, atol=1e-5)
    assert stamp.share(obj) == 0.0, "its residual belongs to another light"
    assert obj[stamp.SWITCH] == 1.0


def test_a_node_that_was_deformed_since_comes_plain(scene, bake, out, capfd):
    bake(plain())
    gltf_export.write(str(out))

    def change(document):
        document["nodes"][0]["scale"] = [1, 2, 1]

    rewritten(out, change)
    scene = imported(out)
    assert "Monkey comes without its bake: it was deformed since" in capfd.readouterr().out
    assert not stamp.baked_objects(scene)


def test_nodes_that_share_a_mesh_are_baked_each(scene, bake, out):
    """A second node of the same mesh, turned: its transfer is another one."""
    bake(plain(), turns=1)
    gltf_export.write(str(out))

    def change(document):
        document["nodes"].append({"name": "Twin", "mesh": 0, "rotation": [0, 1, 0, 0]})
        document["scenes"][0]["nodes"].append(len(document["nodes"]) - 1)

    rewritten(out, change)
    found = held(imported(out))
    one, two = found["Monkey"][1][:, :9], found["Twin"][1][:, :9]
    half = one @ sh.rotation_matrix(np.diag([-1.0, -1.0, 1.0]), 3).T
    np.testing.assert_allclose(matched(two, half), half, atol=1e-5)


def test_what_one_material_cannot_show_comes_plain_and_the_rest_is_lit(scene, bake, out, capfd):
    """Two orders on faces without a material, as another program may write them."""
    for name, order in (("Two", 2), ("Three", 3)):
        obj = monkey(name)
        obj.data.materials.append(bpy.data.materials.new(name))
        bake(obj, order=order)
    gltf_export.write(str(out))

    def change(document):
        for mesh in document["meshes"]:
            mesh["primitives"][0].pop("material")

    rewritten(out, change)
    scene = imported(out)
    (shown,) = stamp.baked_objects(scene)
    assert "comes without its bake" in capfd.readouterr().out
    assert light_state.read(scene) is not None
    (group,) = nodes.groups()
    first = group.nodes["L0"].inputs[1].default_value[:]
    np.testing.assert_allclose(first, light_state.read(scene).radiance_sh[0], atol=1e-6)
    assert stamp.share(shown) == 1.0


@pytest.mark.parametrize(("ratio", "share"), [(2.0, 2.0), (None, 0.0)])
def test_a_scene_with_a_light_keeps_it(scene, bake, out, ratio, share):
    bake(monkey("Theirs"), turns=1)
    theirs = light_state.read(scene)
    gltf_export.write(str(out))
    bpy.ops.wm.read_factory_settings(use_empty=True)
    scene = bpy.context.scene
    baked = theirs.baked_radiance_sh * ratio if ratio else theirs.baked_radiance_sh[::-1]
    ours = light_state.LightState("ours", baked, baked, baked)
    light_state.write(scene, ours)
    bake(monkey("Ours"), turns=1)
    scene = added(out)
    np.testing.assert_array_equal(light_state.read(scene).radiance_sh, baked)
    assert stamp.share(bpy.data.objects["Ours"]) == 1.0
    assert stamp.share(bpy.data.objects["Theirs"]) == pytest.approx(share)


MALFORMED = {
    "version 3": of_mesh(version=3),
    "order 7": of_mesh(order=7),
    "layout has no T8": of_mesh(layout=[*(f"T{i}" for i in range(8)), "", "R0r", "R0g", "R0b"]),
    "2 channels": of_mesh(channels=2),
    'frame "local"': of_mesh(frame="local"),
    "matrix is not nine numbers": of_mesh(matrix=[1, 2]),
    "matrix is not nine": of_mesh(matrix=["a"] * 9),
    "matrix is all zeros": of_mesh(matrix=[0] * 9),
    "scale is neither 1 nor 12 numbers": of_mesh(scale=[1, 2]),
    "layout is not four names": of_mesh(layout="T0T1"),
    "basis": of_mesh(basis="another"),
    "3 visibilities are none of 4": of_mesh(
        layout=[*(f"T{i}" for i in range(9)), "V0", "V1", "V2"], turns=0
    ),
    "layout has names": of_mesh(layout=[*(f"T{i}" for i in range(10)), "R0r", "R0g"], turns=0),
    "radiance_sh is not 25 triples": of_scene(radiance_sh=[[1, 2, 3]]),
    "a cut-out light": of_scene(lights=[{"direction": [0, 0, 0]}]),
    "no prt_light": lambda document: document["scenes"][0].pop("extras"),
    "attribute _PRT_1 is missing": lambda document: attributes_of(document).pop("_PRT_1"),
    "attribute _PRT_1 is neither VEC4": lambda document: attributes_of(document).update(
        _PRT_1=attributes_of(document)["NORMAL"]
    ),
}


def attributes_of(document):
    return document["meshes"][0]["primitives"][0]["attributes"]


@pytest.mark.parametrize("sentence", MALFORMED)
def test_what_is_malformed_is_named_and_comes_plain(scene, bake, out, capfd, sentence):
    bake(rotated(), turns=1)
    gltf_export.write(str(out))
    rewritten(out, MALFORMED[sentence])
    scene = imported(out)
    said = capfd.readouterr().out
    assert sentence in said
    assert "without its bake" in said
    assert "Traceback" not in said
    assert not stamp.baked_objects(scene)
    assert not attributes.names(bpy.data.objects["Monkey"].data)


def test_a_value_that_is_no_number_is_named(scene, bake, out, capfd):
    transfer = bake(monkey())
    gltf_export.write(str(out))
    first = transfer[7, 0, 0].tobytes()
    out.write_bytes(out.read_bytes().replace(first, np.float32(np.nan).tobytes()))
    assert not stamp.baked_objects(imported(out))
    assert "a value that is no number" in capfd.readouterr().out


def test_a_file_without_bakes_comes_as_ever(scene, out, capfd):
    monkey()
    bpy.ops.export_scene.gltf(filepath=str(out))
    assert not stamp.baked_objects(imported(out))
    assert "PRT Baker" not in capfd.readouterr().out


def test_lights_point_as_in_the_file(scene, bake, out):
    bake(monkey(), lights=2)
    gltf_export.write(str(out))
    lights = Glb(out).document["scenes"][0]["extras"]["prt_light"]["lights"]
    for light, peak in zip(lights, light_state.read(imported(out)).peaks, strict=True):
        np.testing.assert_allclose(Y_UP @ peak.direction, light["direction"], atol=1e-6)
