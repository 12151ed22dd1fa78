"""Whatever the input is: the right bake, or one sentence, exit code 2 and nothing half-written."""

import resource

import bmesh
import bpy
import numpy as np
import pytest
import snapshot
from mathutils import Matrix
from meshes import MIRRORED, SHEARED, ball, cube, mesh_of, place
from prt_baker.addon import attributes, cli, stamp
from prt_baker.addon.prt import sh
from prt_baker.addon.prt.files import images
from worlds import environment, loaded, new_world, picture

pytestmark = pytest.mark.usefixtures("temporary")


@pytest.fixture
def out(tmp_path):
    """Where the results belong."""
    folder = tmp_path / "out"
    folder.mkdir()
    return folder


def bake(out, *options):
    """Run the command on the opened scene."""
    outputs = ["--save", out / "a.blend", "--gltf", out / "a.glb", "--report", out / "a.json"]
    return cli.command([str(word) for word in ("--rays", 16, *outputs, *options)])


def refused(scene, out, capsys, *options):
    """The one sentence that a bake ends with; the scene and the folder are as before."""
    before = snapshot.of(scene)
    assert bake(out, *options) == 2
    lines = [line for line in capsys.readouterr().err.splitlines() if "%" not in line]
    assert len(lines) == 1, lines
    assert lines[0].startswith("prt_bake: ")
    assert snapshot.of(scene) == before
    assert list(out.iterdir()) == []
    return lines[0]


def transfer(obj):
    """What was baked for every vertex of ``obj``, (V, n²)."""
    return attributes.read(obj, stamp.read(obj)).transfer[:, 0]


def huge(content):
    """An EXR whose header claims 65536 x 65536 pixels."""
    start = content.index(b"dataWindow\0box2i\0") + 21
    window = np.array([0, 0, 65535, 65535], "<i4").tobytes()
    return content[:start] + window + content[start + 16 :]


DAMAGE = {
    "empty": (lambda _: b"", "is empty"),
    "text": (lambda _: b"no picture\n" * 99, "neither OpenEXR nor Radiance"),
    "huge": (huge, "65536 x 65536"),
    "3 bytes": (lambda content: content[:3], "neither OpenEXR nor Radiance"),
    "in the header": (lambda content: content[:200], "damaged or cut off"),
    "behind the header": (lambda content: content[:420], "damaged or cut off"),
    "in the middle": (lambda content: content[: len(content) // 2], "damaged or cut off"),
    "last byte": (lambda content: content[:-1], "damaged or cut off"),
}


@pytest.mark.parametrize("damage", DAMAGE)
def test_a_damaged_image_is_named(scene, out, capsys, tmp_path, damage):
    place(ball())
    change, words = DAMAGE[damage]
    environment(scene, loaded(picture(), tmp_path / "my sky.exr"))
    content = (tmp_path / "my sky.exr").read_bytes()
    (tmp_path / "my sky.exr").write_bytes(change(content))
    sentence = refused(scene, out, capsys)
    assert str(tmp_path / "my sky.exr") in sentence
    assert words in sentence
    new_world(scene)
    assert words in refused(scene, out, capsys, "--world", tmp_path / "my sky.exr")


@pytest.mark.parametrize("is_read", [True, False], ids=["read", "rendered"])
def test_a_damaged_packed_image_is_named(scene, out, capsys, tmp_path, is_read):
    place(ball())
    image = loaded(picture(), tmp_path / "my sky.exr")
    content = (tmp_path / "my sky.exr").read_bytes()[:-1]
    image.pack(data=content, data_len=len(content))
    nodes = environment(scene, image)
    nodes["mapping"].inputs["Scale"].default_value[0] = 1 if is_read else 2
    assert "'my sky.exr' is damaged or cut off" in refused(scene, out, capsys)


def test_a_missing_image_is_named(scene, out, capsys, tmp_path):
    place(ball())
    environment(scene, loaded(picture(), tmp_path / "my sky.exr"))
    (tmp_path / "my sky.exr").unlink()
    assert f"'{tmp_path}/my sky.exr' is missing" in refused(scene, out, capsys)
    assert "does not exist" in refused(scene, out, capsys, "--world", tmp_path / "no.hdr")


def test_a_world_without_light_is_said(scene, out, capsys):
    place(ball())
    assert "has no world" in refused(scene, out, capsys)
    environment(scene, None)
    assert "has no image" in refused(scene, out, capsys)
    scene.world.node_tree.nodes.clear()
    assert "has no light" in refused(scene, out, capsys)


@pytest.mark.parametrize("value", ["rotation", "strength"])
def test_a_world_that_is_not_finite_is_said(scene, out, capsys, tmp_path, value):
    place(ball())
    nodes = environment(scene, loaded(picture(), tmp_path / "sky.exr"))
    if value == "rotation":
        nodes["mapping"].inputs["Rotation"].default_value[0] = float("nan")
    else:
        nodes["background"].inputs["Strength"].default_value = float("inf")
    assert "is not finite" in refused(scene, out, capsys)


def flat():
    mesh = bpy.data.meshes.new("Flat")
    mesh.from_pydata([(0, 0, 0), (1, 1, 1), (2, 2, 2)], [], [(0, 1, 2)])
    return mesh


def edges():
    mesh = bpy.data.meshes.new("Edges")
    mesh.from_pydata([(0, 0, 0), (1, 0, 0)], [(0, 1)], [])
    return mesh


def not_finite():
    mesh = ball()
    mesh.vertices[7].co.x = float("nan")
    return mesh


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: bpy.data.cameras.new("Camera"), "no mesh to bake"),
        (lambda: bpy.data.meshes.new("Nothing"), "has no faces"),
        (edges, "has no faces"),
        (flat, "only faces without area"),
        (not_finite, r"NaN, infinite or too far away (1 of 162)"),
    ],
)
def test_a_mesh_that_cannot_be_baked_is_said(scene, out, capsys, make, words):
    new_world(scene)
    place(make())
    assert words in refused(scene, out, capsys)


def test_edit_mode_is_said(scene, out, capsys):
    new_world(scene)
    bpy.context.view_layer.objects.active = place(ball())
    bpy.ops.object.mode_set(mode="EDIT")
    assert "is in Edit Mode" in refused(scene, out, capsys)
    bpy.ops.object.mode_set(mode="OBJECT")


def test_linked_data_is_said(scene, out, capsys, tmp_path):
    new_world(scene)
    obj = place(ball(), "Linked")
    bpy.data.libraries.write(str(tmp_path / "library.blend"), {obj})
    bpy.data.objects.remove(obj)
    with bpy.data.libraries.load(str(tmp_path / "library.blend"), link=True) as (_, wanted):
        wanted.objects = ["Linked"]
    scene.collection.objects.link(wanted.objects[0])
    assert "linked from another file" in refused(scene, out, capsys)


def test_a_picture_of_a_world_that_finds_no_room_is_said(scene, out, capsys, tmp_path):
    place(ball())
    nodes = environment(scene, loaded(picture(), tmp_path / "sky.exr"))
    nodes["mapping"].inputs["Scale"].default_value[0] = 2
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (1 << 20, before[1]))
    try:
        sentence = refused(scene, out, capsys)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
    assert "temporary folder" in sentence
    assert "make room" in sentence


@pytest.mark.parametrize(
    "matrix", [MIRRORED, SHEARED, Matrix.Scale(1e-4, 4), Matrix.Translation((1e6, 0, 0))]
)
def test_a_ball_sees_half_of_the_sky_however_it_is_scaled(scene, out, matrix):
    """The clamped cosine about the outer normal, which no facet of a convex mesh hides."""
    new_world(scene)
    obj = place(ball(), matrix=matrix)
    assert bake(out, "--rays", 256) == 0
    local = np.array([n.vector for n in obj.data.vertex_normals])
    normals = local @ np.linalg.inv(np.array(matrix)[:3, :3])
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    bands = np.repeat([1, 2 / 3, 1 / 4], [1, 3, 5])
    np.testing.assert_allclose(transfer(obj), bands * sh.basis(normals, 3), atol=0.01)


def ball_over_boxes(matrix, applied):
    """A ball that dips into a row of boxes, mirrored by its matrix or in its mesh."""
    meshes = ball(), cube()
    meshes[0].transform(Matrix.Translation((0.3, 0.2, 1.9)))
    if applied:
        for mesh in meshes:
            mesh.transform(matrix)
            mesh.flip_normals()
    boxes = place(meshes[1], "Boxes", Matrix() if applied else matrix)
    boxes.modifiers.new("Array", "ARRAY").relative_offset_displace = (0, 1.2, 0)
    return place(meshes[0], "Ball", Matrix() if applied else matrix)


def test_a_mirrored_object_is_baked_as_its_mirrored_mesh(scene, out):
    """But for the noise: a mirrored mesh's triangles run the other way round, and what is traced
    inside of them lies elsewhere."""
    mirror = Matrix.Translation((0.5, 0, 0.3)) @ Matrix.Diagonal((-1, 1, 1, 1))
    new_world(scene)
    baked = []
    for applied in (False, True):
        obj = ball_over_boxes(mirror, applied)
        assert bake(out, "--object", obj.name, "--rays", 1024) == 0
        baked.append(transfer(obj))
        for other in list(scene.objects):
            bpy.data.objects.remove(other)
    assert np.ptp(baked[0][:, 0]) > 0.2, "some of it is in shadow"
    np.testing.assert_allclose(*baked, atol=2e-3)


def test_a_broken_neighbour_is_left_out_and_counted(scene, out):
    new_world(scene)
    obj = place(ball(), "Fine")
    place(not_finite(), "Broken", Matrix.Translation((0, 0, 3)))
    assert bake(out, "--object", "Fine") == 0
    assert '"dropped_triangles": 5' in (out / "a.json").read_text("utf-8")
    assert np.isfinite(transfer(obj)).all()


def test_faces_without_area_show_nothing_wrong(scene, out):
    mesh = bpy.data.meshes.new("Mixed")
    points = [(0, 0, 0), (1, 0, 0), (2, 0, 0), (0, 1, 0), (5, 5, 5)]
    mesh.from_pydata(points, [(0, 4)], [(0, 1, 2), (0, 1, 3)])
    new_world(scene)
    obj = place(mesh)
    assert bake(out, "--verify") == 0
    sky = sh.basis(np.array([[0.0, 0, 1]]), 3)[0, 0]
    shown = transfer(obj)[3:, 0]
    np.testing.assert_allclose(shown, sky, atol=1e-5)


@pytest.mark.parametrize("name", ["a b", "Größe 球", "../../x", "-dash", "a\nb", "%s {0}"])
def test_any_name_is_baked(scene, out, name):
    new_world(scene)
    obj = place(mesh_of_quad(), name)
    assert bake(out, f"--object={name}") == 0
    assert sorted(path.name for path in out.iterdir()) == ["a.blend", "a.glb", "a.json"]
    assert obj[stamp.SWITCH] == 1


def mesh_of_quad():
    return mesh_of(bmesh.ops.create_grid, x_segments=1, y_segments=1, size=1)


def test_a_sky_without_a_sound_pixel_is_black(scene, out, tmp_path):
    images.write_exr(str(tmp_path / "sky.exr"), np.full((4, 8, 3), np.nan, np.float32))
    place(mesh_of_quad())
    environment(scene, bpy.data.images.load(str(tmp_path / "sky.exr")))
    assert bake(out) == 0
    assert '"nan": 32' in (out / "a.json").read_text("utf-8")
