"""EXT_lights_image_based: stock viewers light plain materials by the world that was exported."""

from types import SimpleNamespace

import bpy
import numpy as np
import pytest
from babylon_page import seen_by_babylon
from glb import Glb
from gltf_scenes import monkey
from gltf_validator import assert_valid
from gltf_worlds import bundled, colour, hdri
from mathutils import Euler
from prt_baker.addon import gltf_export, gltf_panel

NAME = "EXT_lights_image_based"
TURNED = 0.7
BLENDER = np.array([[1, 0, 0], [0, 0, -1], [0, 1, 0]])  # takes the file's directions to Blender's
AXES = np.concatenate([np.eye(3), -np.eye(3)])
DIRECTIONS = np.concatenate(
    [
        AXES,
        [[0.48, 0.6, 0.64], [-0.6, -0.64, 0.48], [0.64, 0.48, -0.6], [-0.64, 0.6, -0.48]],
        [[0.6, -0.48, 0.64]],
    ]
)
COSINE = np.pi * np.array([1, 2 / 3, 2 / 3, 2 / 3, 1 / 4, 1 / 4, 1 / 4, 1 / 4, 1 / 4])


@pytest.fixture(scope="module")
def lit(registered, tmp_path_factory):
    """A ball in a real HDRI that is turned, exported; its light, decoded."""
    path = tmp_path_factory.mktemp("ibl") / "ball.glb"
    bpy.ops.wm.read_factory_settings(use_empty=True)
    ball()
    hdri(bpy.context.scene, "courtyard", TURNED)
    return written(path)


def ball():
    bpy.ops.mesh.primitive_uv_sphere_add(segments=64, ring_count=32)
    bpy.ops.object.shade_smooth()
    bpy.context.object.data.materials.append(bpy.data.materials.new("Ball"))


def written(path):
    with gltf_panel.chosen(bpy.context.scene, None, None, ibl=True):
        gltf_export.write(str(path))
    glb = Glb(path)
    (light,) = glb.document["extensions"][NAME]["lights"]
    pictures = [[glb.picture(image) for image in mip] for mip in light["specularImages"]]
    mips = [np.array([decoded(face) for face in mip]) for mip in pictures]
    return SimpleNamespace(path=path, glb=glb, light=light, mips=mips, pictures=pictures)


def decoded(pixels):
    """Radiance of RGBD."""
    shares = pixels / 255
    return shares[..., :3] ** 2.2 / shares[..., 3:]


@pytest.fixture(scope="module")
def world():
    """The HDRI's texels: directions in the file's axes (H W, 3), solid angles and radiance."""
    image = bpy.data.images.load(str(bundled("courtyard")), check_existing=False)
    width, height = image.size
    pixels = np.empty(4 * width * height, np.float32)
    image.pixels.foreach_get(pixels)
    bpy.data.images.remove(image)
    radiance = pixels.reshape(height, width, 4)[..., :3].astype(float)
    up = (np.arange(height) + 0.5) / height * np.pi - np.pi / 2
    around = 2 * np.pi * (0.5 - (np.arange(width) + 0.5) / width)
    up, around = np.meshgrid(up, around, indexing="ij")
    at = np.stack([np.cos(up) * np.cos(around), np.cos(up) * np.sin(around), np.sin(up)], axis=2)
    turn = np.array(Euler((0, 0, TURNED)).to_matrix())  # of the Mapping: world to picture
    solid = np.cos(up) * (np.pi / height) * (2 * np.pi / width)
    to_file = BLENDER.T @ turn.T
    solid *= 4 * np.pi / solid.sum()
    return at.reshape(-1, 3) @ to_file.T, solid.ravel(), radiance.reshape(-1, 3)


def diffuse(world, normals):
    """What leaves white surfaces that see all of ``world``."""
    directions, solid, radiance = world
    cosines = np.maximum(normals @ directions.T, 0) * solid
    return cosines @ radiance / np.pi


def filtered(world, directions, roughness):
    """The mean of ``world`` under the lobe D cos of GGX about each direction."""
    towards, solid, radiance = world
    cosines = directions @ towards.T
    half = np.sqrt(np.maximum(0.5 + 0.5 * cosines, 0))
    distribution = 1 / np.square(half**2 * (roughness**4 - 1) + 1)
    weights = distribution * np.maximum(cosines, 0) * solid
    return weights @ radiance / weights.sum(axis=1, keepdims=True)


def basis(at):
    """Nine harmonics with the Condon-Shortley phase."""
    x, y, z = at.T
    return np.stack(
        [
            0.28209479 + 0 * x,
            -0.48860251 * y,
            0.48860251 * z,
            -0.48860251 * x,
            1.09254843 * x * y,
            -1.09254843 * y * z,
            0.31539157 * (3 * z * z - 1),
            -1.09254843 * x * z,
            0.54627422 * (x * x - y * y),
        ],
        axis=1,
    )


def in_cube(directions):
    """Directions of the file in the axes of the cube map."""
    return directions * (-1, 1, 1)


def test_it_is_as_the_extension_says(lit):
    document, light = lit.glb.document, lit.light
    assert document["extensionsUsed"] == [NAME]
    assert "extensionsRequired" not in document
    assert document["scenes"][0]["extensions"] == {NAME: {"light": 0}}
    assert set(light) == {
        "name", "intensity", "irradianceCoefficients", "specularImageSize", "specularImages",
    }  # fmt: skip
    assert np.shape(light["irradianceCoefficients"]) == (9, 3)
    assert np.shape(light["specularImages"]) == (5, 6)
    sizes = [256, 128, 64, 32, 16]
    assert light["specularImageSize"] == sizes[0]
    for size, mip in zip(sizes, lit.pictures, strict=True):
        assert {face.shape for face in mip} == {(size, size, 4)}
    for index in np.ravel(light["specularImages"]):
        assert document["images"][index]["mimeType"] == "image/png"
    assert_valid(lit.path)


def test_its_irradiance_is_that_of_the_world(lit, world):
    """As Babylon.js evaluates it: with the phase, and the cosine's factors inside."""
    found = basis(in_cube(DIRECTIONS)) @ lit.light["irradianceCoefficients"]
    found *= lit.light["intensity"] / np.pi
    directions, solid, radiance = world
    projected = (basis(in_cube(directions)) * solid[:, None]).T @ radiance
    nine = basis(in_cube(DIRECTIONS)) @ (COSINE[:, None] * projected) / np.pi
    np.testing.assert_allclose(found, nine, rtol=1e-3)
    exact = diffuse(world, DIRECTIONS)
    assert np.sqrt(np.square(found - exact).mean()) < 0.05 * np.sqrt(np.square(exact).mean())


def test_what_pictures_cannot_hold_is_in_the_intensity(registered, tmp_path):
    bpy.ops.wm.read_factory_settings(use_empty=True)
    ball()
    background = colour(bpy.context.scene, (0.2, 0.5, 1))
    for strength in (1e-4, 1.0, 1e4):
        background.inputs["Strength"].default_value = strength
        lit = written(tmp_path / "ball.glb")
        assert (lit.light["intensity"] == 1.0) == (strength == 1.0)
        shown = lit.mips[0][0, 0, 0] * lit.light["intensity"]
        np.testing.assert_allclose(shown, strength * np.array((0.2, 0.5, 1)), rtol=0.02)
        first = lit.light["intensity"] * np.array(lit.light["irradianceCoefficients"])[0]
        expected = np.pi * strength * np.array((0.2, 0.5, 1))
        np.testing.assert_allclose(first * 0.28209479, expected, rtol=1e-6)


@pytest.mark.parametrize("mip", [1, 2, 3, 4])
def test_mips_are_filtered_by_their_roughness(lit, world, mip):
    faces = lit.mips[mip] * lit.light["intensity"]
    size = faces.shape[1]
    rng = np.random.default_rng(mip)
    face, row, column = rng.integers((6, size, size), size=(40, 3)).T
    towards = in_cube(
        np.array([texel(*place, size) for place in zip(face, row, column, strict=True)])
    )
    truth = filtered(world, towards, mip / 4)
    off = faces[face, row, column] - truth
    assert np.sqrt(np.square(off).mean()) < 0.02 * np.sqrt(np.square(truth).mean())


def test_the_first_mip_is_the_world(lit, world):
    """Averaged over blocks of texels, which hold some of the HDRI's each."""
    directions, solid, radiance = world
    at = in_cube(directions)
    axis = np.abs(at).argmax(axis=1)
    face = 2 * axis + (np.take_along_axis(at, axis[:, None], 1)[:, 0] < 0)
    means = np.array([(solid[face == k] @ radiance[face == k]) for k in range(6)])
    size = lit.mips[0].shape[1]
    edges = (np.arange(size) + 0.5) / size * 2 - 1
    across, up = np.meshgrid(edges, edges)
    of_texel = (1 + across**2 + up**2) ** -1.5 * (2 / size) ** 2
    found = np.einsum("fyxc,yx->fc", lit.mips[0], of_texel) * lit.light["intensity"]
    np.testing.assert_allclose(found, means, rtol=0.02)


def texel(face, row, column, size):
    """The direction of a texel of a stored face, by the table of OpenGL, whose t is up here."""
    s, t = 2 * (column + 0.5) / size - 1, 1 - 2 * (row + 0.5) / size
    at = [(1, -t, -s), (-1, -t, s), (s, 1, t), (s, -1, -t), (s, -t, 1), (-s, -t, -1)][face]
    return np.array(at) / np.linalg.norm(at)


def test_babylon_lights_plain_materials_by_it(lit, world, page):
    """Read off a ball's middle, from all sides."""
    found = seen_by_babylon(page, lit.path, DIRECTIONS)
    assert found["isCube"]
    assert found["size"] == 256
    exact = diffuse(world, DIRECTIONS)
    off = np.array(found["diffuse"]) - exact
    assert np.sqrt(np.square(off).mean()) < 0.05 * np.sqrt(np.square(exact).mean())
    nine = basis(in_cube(DIRECTIONS)) @ lit.light["irradianceCoefficients"]
    expected = nine * lit.light["intensity"] / np.pi
    np.testing.assert_allclose(found["diffuse"], expected, rtol=5e-3, atol=1e-3)
    rough = filtered(world, DIRECTIONS, 0.25)
    beside = expected - rough  # Babylon.js mixes a little of it in, the more the rougher
    mixed = ((found["rough"] - rough) * beside).sum() / np.square(beside).sum()
    assert 0 <= mixed < 0.15
    off = found["rough"] - (rough + mixed * beside)
    assert np.sqrt(np.square(off).mean()) < 0.01 * np.sqrt(np.square(rough).mean())
    assert found["gamma"], "Babylon.js does not decode twice any more: say so in the docs"


def test_a_world_of_one_colour_takes_one_small_mip(registered, tmp_path):
    bpy.ops.wm.read_factory_settings(use_empty=True)
    ball()
    colour(bpy.context.scene, (0.2, 0.5, 3))
    lit = written(tmp_path / "ball.glb")
    assert_valid(lit.path)
    assert [mip.shape for mip in lit.mips] == [(6, 16, 16, 3)]
    shown = lit.mips[0] * lit.light["intensity"]
    np.testing.assert_allclose(shown, np.broadcast_to((0.2, 0.5, 3), shown.shape), rtol=0.02)
    irradiance = lit.light["intensity"] * np.array(lit.light["irradianceCoefficients"])
    np.testing.assert_allclose(irradiance[0] * 0.28209479, np.pi * np.array((0.2, 0.5, 3)))
    np.testing.assert_allclose(irradiance[1:], 0, atol=1e-9)


def test_it_is_off_unless_it_is_wanted(scene, bake, out):
    colour(scene, (1, 1, 1))
    bake(monkey())
    gltf_export.write(str(out))
    assert (
        "extensionsUsed" not in Glb(out).document or NAME not in Glb(out).document["extensionsUsed"]
    )


def test_it_stands_beside_bakes(registered, scene, bake, out):
    colour(scene, (1, 1, 1))
    bake(monkey(), turns=1)
    lit = written(out)
    assert lit.glb.prt("Monkey")
    assert "prt_light" in lit.glb.document["scenes"][0]["extras"]
    assert_valid(out)


def test_a_scene_without_a_world_is_told(registered, scene, out, capfd):
    monkey()
    with gltf_panel.chosen(scene, None, None, ibl=True):
        gltf_export.write(str(out))
    assert NAME not in Glb(out).document.get("extensions", {})
    said = capfd.readouterr().out
    assert "Left out the image-based light of Scene: The scene has no world" in said
