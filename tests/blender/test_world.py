"""The world as light: reading its nodes says the same as rendering them."""

from math import pi
from pathlib import Path

import bpy
import numpy as np
import pytest
from prt_baker.addon import world, world_images, world_render
from prt_baker.addon.prt.errors import BakeError
from prt_baker.addon.prt.files import images
from prt_baker.addon.prt.light import lat_long, projection
from worlds import environment, generated, loaded, new_world, picture

TYPES = ("POINT", "TEXTURE", "VECTOR", "NORMAL")


def read(scene, folder=Path()):
    depsgraph = bpy.context.evaluated_depsgraph_get()
    return world.read(scene, depsgraph, folder)


def radiance_sh(source):
    """Coefficients (25, 3) of the light that ``source`` is."""
    return projection.world_sh(
        projection.project(source).image_sh, source.strength, source.rotation
    )


def rendered_sh(scene):
    pixels = world_render.render(scene)
    return lat_long.project(pixels, 5)


def difference(one, other):
    return np.linalg.norm(one - other) / np.linalg.norm(other)


def data_blocks():
    kinds = [name for name in dir(bpy.data) if hasattr(getattr(bpy.data, name), "foreach_get")]
    return {kind: sorted(block.name for block in getattr(bpy.data, kind)) for kind in kinds}


@pytest.fixture
def quick(monkeypatch):
    """Renders that cost a tenth of a second."""
    monkeypatch.setattr(world_render, "SAMPLES", 1)
    monkeypatch.setattr(world_render, "PEAK_SAMPLES", 1)


@pytest.mark.parametrize("kind", TYPES)
def test_reading_a_turned_map_agrees_with_rendering_it(scene, quick, kind):
    environment(scene, generated(picture()), kind=kind)
    got = read(scene)
    assert got.follows
    assert difference(radiance_sh(got.source), rendered_sh(scene)) < 0.01
    assert difference(projection.project(got.source).image_sh * 1.5, rendered_sh(scene)) > 0.1


@pytest.mark.parametrize("how", ["file", "packed", "painted", "direct"])
def test_every_kind_of_image_reads_the_same(scene, tmp_path, how):
    pixels = picture()
    image = loaded(pixels, tmp_path / "größe 1.exr") if how != "direct" else generated(pixels)
    if how == "packed":
        image.pack()
        (tmp_path / "größe 1.exr").unlink()
    if how == "painted":
        image.pixels[0] = pixels[-1, 0, 0] = 7
        assert image.is_dirty
    environment(scene, image)
    got = read(scene, tmp_path)
    assert got.follows
    assert got.image_key
    plain = lat_long.project(pixels, 5)
    np.testing.assert_allclose(projection.project(got.source).image_sh, plain, rtol=1e-5, atol=1e-5)
    assert (got.source.image is None) == (how in ("painted", "direct"))


def test_a_generated_image_that_was_packed_is_read_from_its_bytes(scene, tmp_path):
    pixels = picture()
    image = generated(pixels)
    image.pack()
    environment(scene, image)
    got = read(scene, tmp_path)
    assert got.source.image is not None
    plain = lat_long.project(pixels, 5)
    np.testing.assert_allclose(projection.project(got.source).image_sh, plain, rtol=2e-3, atol=2e-3)


def test_a_path_is_relative_to_the_blend_file(scene, tmp_path):
    image = loaded(picture(), tmp_path / "sky.exr")
    environment(scene, image)
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "scene.blend"))
    image.filepath = "//sky.exr"
    assert read(scene).source.image == str(tmp_path / "sky.exr")


def test_a_colour_is_strength_alone(scene):
    background = new_world(scene).nodes["Background"]
    background.inputs["Color"].default_value = (0.2, 0.4, 0.8, 1)
    background.inputs["Strength"].default_value = 3
    got = read(scene)
    assert got.source.strength == pytest.approx((0.6, 1.2, 2.4))
    assert (got.source.image, got.source.pixels, got.image_key) == (None, None, "")
    assert got.follows


@pytest.mark.skipif(bpy.app.version >= (5, 0), reason="every world has nodes since 5.0")
def test_a_world_without_nodes_is_its_colour(scene):
    scene.world = bpy.data.worlds.new("World")
    scene.world.color = (0.1, 0.2, 0.3)
    assert read(scene).source.strength == pytest.approx((0.1, 0.2, 0.3))


def test_reroutes_are_looked_through(scene):
    nodes = environment(scene, generated(picture()))
    tree = scene.world.node_tree
    expected = read(scene)
    for source, target in (
        (nodes["mapping"].outputs[0], nodes["texture"].inputs[0]),
        (nodes["coordinates"].outputs["Generated"], nodes["mapping"].inputs[0]),
        (nodes["texture"].outputs[0], nodes["background"].inputs["Color"]),
    ):
        reroute = tree.nodes.new("NodeReroute")
        tree.links.new(source, reroute.inputs[0])
        tree.links.new(reroute.outputs[0], target)
    assert read(scene).source == expected.source


def scaled(nodes, tree):
    nodes["mapping"].inputs["Scale"].default_value = (1, 1, 2)


def shifted(nodes, tree):
    nodes["mapping"].inputs["Location"].default_value[0] = 0.5


def mirror_ball(nodes, tree):
    nodes["texture"].projection = "MIRROR_BALL"


def perceptual(nodes, tree):
    nodes["texture"].image.colorspace_settings.name = "sRGB"


def driven_strength(nodes, tree):
    tree.links.new(tree.nodes.new("ShaderNodeValue").outputs[0], nodes["background"].inputs[1])


def graded(nodes, tree):
    gamma = tree.nodes.new("ShaderNodeGamma")
    tree.links.new(nodes["texture"].outputs[0], gamma.inputs[0])
    tree.links.new(gamma.outputs[0], nodes["background"].inputs["Color"])


def reflected(nodes, tree):
    tree.links.new(nodes["coordinates"].outputs["Reflection"], nodes["mapping"].inputs[0])


def muted(nodes, tree):
    nodes["mapping"].mute = True


@pytest.mark.parametrize(
    "change",
    [scaled, shifted, mirror_ball, perceptual, driven_strength, graded, reflected, muted],
)
def test_any_other_tree_is_rendered_and_follows_nothing(scene, quick, change):
    nodes = environment(scene, generated(picture()))
    change(nodes, scene.world.node_tree)
    got = read(scene)
    assert not got.follows
    assert got.source.pixels.shape == (world_render.HEIGHT, world_render.WIDTH, 3)
    assert got.source.pixels.dtype == np.float32
    assert (got.source.strength, got.image_key) == ((1, 1, 1), world.RENDERED)


def test_rendering_leaves_nothing_behind(scene, quick):
    nodes = environment(scene, generated(picture()))
    tree = scene.world.node_tree
    graded(nodes, tree)
    group = bpy.data.node_groups.new("Group", "ShaderNodeTree")
    tree.nodes.new("ShaderNodeGroup").node_tree = group
    before = data_blocks()
    world_render.render(scene)
    assert data_blocks() == before
    assert bpy.context.scene == scene


def test_a_failed_render_leaves_nothing_behind(scene, monkeypatch):
    new_world(scene)
    before = data_blocks()
    monkeypatch.setattr(world_render, "_load", lambda path: 1 / 0)
    with pytest.raises(ZeroDivisionError):
        world_render.render(scene)
    assert data_blocks() == before


def test_a_rendered_world_is_what_lights_and_not_what_the_camera_sees(scene, quick):
    """Light Path, in a group too, answers as for a diffuse ray."""
    tree = new_world(scene)
    group = bpy.data.node_groups.new("Seen", "ShaderNodeTree")
    group.interface.new_socket("Camera", in_out="OUTPUT", socket_type="NodeSocketFloat")
    inside, end = group.nodes.new("ShaderNodeLightPath"), group.nodes.new("NodeGroupOutput")
    group.links.new(inside.outputs["Is Camera Ray"], end.inputs[0])
    nested, path = tree.nodes.new("ShaderNodeGroup"), tree.nodes.new("ShaderNodeLightPath")
    nested.node_tree = group
    mix = tree.nodes.new("ShaderNodeMath")
    mix.operation = "SUBTRACT"  # 1 for a diffuse ray, -1 for the camera's
    tree.links.new(path.outputs["Is Diffuse Ray"], mix.inputs[0])
    tree.links.new(nested.outputs[0], mix.inputs[1])
    tree.links.new(mix.outputs[0], tree.nodes["Background"].inputs["Strength"])
    tree.nodes["Background"].inputs["Color"].default_value = (0.5, 0.25, 0.125, 1)
    np.testing.assert_allclose(read(scene).source.pixels[7, 9], (0.5, 0.25, 0.125), rtol=1e-5)
    assert len(inside.outputs["Is Camera Ray"].links) == 1


def test_the_output_of_eevee_is_the_one_that_counts(scene, quick):
    tree = new_world(scene)
    tree.nodes["Background"].inputs["Strength"].default_value = 5
    other, output = (
        tree.nodes.new("ShaderNodeBackground"),
        tree.nodes.new("ShaderNodeOutputWorld"),
    )
    other.inputs["Color"].default_value = (1, 1, 1, 1)
    other.inputs["Strength"].default_value = 2
    output.target = "EEVEE"
    tree.links.new(other.outputs[0], output.inputs["Surface"])
    assert read(scene).source.strength == (2, 2, 2)
    value = tree.nodes.new("ShaderNodeValue")
    value.outputs[0].default_value = 3
    tree.links.new(value.outputs[0], other.inputs["Strength"])
    assert read(scene).source.pixels[3, 3] == pytest.approx((3, 3, 3), rel=1e-5)


def test_an_animated_world_is_read_at_the_current_frame(scene, quick):
    nodes = environment(scene, generated(picture()), rotation=(0, 0, 0))
    turn = nodes["mapping"].inputs["Rotation"]
    turn.keyframe_insert("default_value", frame=1)
    turn.default_value = (0, 0, 2)
    turn.keyframe_insert("default_value", frame=3)
    seen = []
    for frame in (1, 2, 3):
        scene.frame_set(frame)
        seen.append(radiance_sh(read(scene).source))
        assert difference(seen[-1], rendered_sh(scene)) < 0.01
    assert difference(seen[0], seen[1]) > 0.05


def test_the_light_of_a_small_sun_is_measured(scene):
    """A disc of half a degree, between the pixels: its solid angle times its radiance."""
    tree, cosine = new_world(scene), np.cos(np.radians(0.27))
    nodes = {
        name: tree.nodes.new(f"ShaderNode{name}") for name in ("TexCoord", "VectorMath", "Math")
    }
    nodes["VectorMath"].operation = "DOT_PRODUCT"
    nodes["VectorMath"].inputs[1].default_value = np.array((1.0, 0.8, 0.7)) / np.sqrt(2.13)
    nodes["Math"].operation = "GREATER_THAN"
    nodes["Math"].inputs[1].default_value = cosine
    tree.links.new(nodes["TexCoord"].outputs["Generated"], nodes["VectorMath"].inputs[0])
    tree.links.new(nodes["VectorMath"].outputs["Value"], nodes["Math"].inputs[0])
    tree.links.new(nodes["Math"].outputs[0], tree.nodes["Background"].inputs["Strength"])
    tree.nodes["Background"].inputs["Color"].default_value = (1, 1, 1, 1)
    expected = 2 * pi * (1 - cosine) / np.sqrt(4 * pi)
    assert rendered_sh(scene)[0] == pytest.approx((expected,) * 3, rel=0.02)


def no_world(scene, folder):
    scene.world = None


def no_image(scene, folder):
    environment(scene, None)


def no_image_in_a_tree(scene, folder):
    graded(environment(scene, None), scene.world.node_tree)


def unlinked(scene, folder):
    tree = new_world(scene)
    tree.links.clear()


def missing(scene, folder):
    environment(scene, loaded(picture(), folder / "sky.exr"))
    (folder / "sky.exr").unlink()


def missing_in_a_tree(scene, folder):
    graded(environment(scene, loaded(picture(), folder / "sky.exr")), scene.world.node_tree)
    (folder / "sky.exr").unlink()


def damaged_in_a_tree(scene, folder):
    image = loaded(picture(), folder / "sky.exr")
    (folder / "sky.exr").write_bytes((folder / "sky.exr").read_bytes()[:900])
    graded(environment(scene, image), scene.world.node_tree)


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (no_world, "has no world"),
        (no_image, "has no image"),
        (no_image_in_a_tree, "has no image"),
        (unlinked, "has no light"),
        (missing, "sky.exr' is missing"),
        (missing_in_a_tree, "sky.exr' is missing"),
        (damaged_in_a_tree, "sky.exr"),
    ],
)
def test_a_world_without_light_is_refused_in_one_sentence(scene, tmp_path, make, words):
    make(scene, tmp_path)
    with pytest.raises(BakeError, match=words) as refusal:
        read(scene, tmp_path)
    assert "\n" not in str(refusal.value)


def test_a_named_file_is_the_light(tmp_path):
    path = tmp_path / "sky.exr"
    images.write_exr(str(path), picture())
    got = world.from_file(path)
    assert (got.source.image, got.source.strength) == (str(path), (1, 1, 1))
    assert got.follows


def test_the_key_of_a_named_file_is_that_of_a_world_that_shows_it(scene, tmp_path):
    image = loaded(picture(), tmp_path / "sky.exr")
    environment(scene, image)
    assert read(scene).image_key == world.from_file(tmp_path / "sky.exr").image_key


@pytest.mark.parametrize("name", ["nothing.exr", "sky.png"])
def test_a_file_that_is_no_map_is_refused(tmp_path, name):
    (tmp_path / "sky.png").touch()
    with pytest.raises(BakeError, match="World image"):
        world.from_file(tmp_path / name)


def test_a_key_names_the_content(scene, tmp_path):
    path = tmp_path / "sky.exr"
    image = loaded(picture(), path)
    key = world_images.key(image)
    assert world_images.key(image) == key
    images.write_exr(str(path), picture(seed=1))
    assert world_images.key(image) != key
    grid = generated(picture())
    key = world_images.key(grid)
    grid.generated_type = "UV_GRID"
    assert world_images.key(grid) != key
