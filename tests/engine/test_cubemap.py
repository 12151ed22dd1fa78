import numpy as np
import pytest
from prt_baker.addon.prt import sh
from prt_baker.addon.prt.light import cubemap, lat_long

# What each face looks at, in Blender's axes: files have +Y up and +Z ahead
AHEAD = [(1, 0, 0), (-1, 0, 0), (0, 0, 1), (0, 0, -1), (0, 1, 0), (0, -1, 0)]
LAYOUTS = [(4, 3), (3, 4), (6, 1), (1, 6)]


def opengl_direction(face, s, t):
    """OpenGL 4.6, table 8.19, inverted, in the file's axes; s and t from -1 to 1, t down."""
    x, y, z = [(1, -t, -s), (-1, -t, s), (s, 1, t), (s, -1, -t), (s, -t, 1), (-s, -t, -1)][face]
    return np.array([x, y, z]) / np.sqrt(s * s + t * t + 1)


def radiance(directions):
    """Smooth, of no symmetry, and of high order."""
    x, y, z = np.moveaxis(directions, -1, 0)
    return np.stack([np.exp(x - 0.5 * y), 1 + x * y * z + z**5, np.exp(2 * z * y)], axis=-1)


def faces_of(size):
    texels = [radiance(cubemap.directions(face, size)) for face in range(6)]
    return np.stack(texels).astype(np.float32)


def laid_out(faces, layout):
    """The picture (H, W, 3) of some faces, with NaN where no face is."""
    size, (columns, rows) = faces.shape[1], layout
    places = {
        (4, 3): [(2, 1), (0, 1), (1, 0), (1, 2), (1, 1), (3, 1)],
        (3, 4): [(2, 1), (0, 1), (1, 0), (1, 2), (1, 1), (1, 3)],
        (6, 1): [(k, 0) for k in range(6)],
        (1, 6): [(0, k) for k in range(6)],
    }[layout]
    picture = np.full((rows * size, columns * size, 3), np.nan, np.float32)
    for face, (x, y) in enumerate(places):
        turned = faces[face, ::-1, ::-1] if (layout, face) == ((3, 4), 5) else faces[face]
        picture[y * size : (y + 1) * size, x * size : (x + 1) * size] = turned
    return picture


@pytest.mark.parametrize("size", [1, 2, 3, 64, 511])
def test_texels_cover_the_sphere(size):
    assert 6 * cubemap.solid_angles(size).sum() == pytest.approx(4 * np.pi, rel=1e-12)


def test_texels_of_a_large_face_cover_the_sphere_without_holding_it():
    parts = [slice(row, row + 256) for row in range(0, 4096, 256)]
    chunks = (cubemap.solid_angles(4096, part) for part in parts)
    total, smallest = zip(*((chunk.sum(), chunk.min()) for chunk in chunks), strict=True)
    assert 6 * sum(total) == pytest.approx(4 * np.pi, rel=1e-9)
    assert min(smallest) > 0


@pytest.mark.parametrize("size", [512, 1024, 4096])
def test_texels_are_exact_where_float32_fails(size):
    """A texel is so small that the solid angle at its centre is right to its size squared."""
    part = slice(size // 2 - 8, size // 2 + 8)
    exact = cubemap.solid_angles(size, part)
    centre = (2 * np.arange(size) + 1) / size - 1
    density = (1 + centre**2 + centre[part, None] ** 2) ** -1.5 * (2 / size) ** 2
    np.testing.assert_allclose(exact, density, rtol=4 / size**2 + 1e-7)


def test_texels_are_even_in_both_axes():
    angles = cubemap.solid_angles(33)
    np.testing.assert_allclose(angles, angles[::-1], rtol=1e-12)
    np.testing.assert_allclose(angles, angles.T, rtol=1e-12)


@pytest.mark.parametrize("face", range(6))
def test_the_middle_of_a_face_looks_along_its_axis(face):
    np.testing.assert_allclose(cubemap.directions(face, 3)[1, 1], AHEAD[face], atol=1e-15)


@pytest.mark.parametrize("face", range(6))
def test_faces_are_opengls_with_y_and_z_exchanged(face):
    centre = (2 * np.arange(5) + 1) / 5 - 1
    expected = [[opengl_direction(face, s, t)[[0, 2, 1]] for s in centre] for t in centre]
    np.testing.assert_allclose(cubemap.directions(face, 5), expected, atol=1e-15)


def test_faces_are_not_mirrored():
    np.testing.assert_allclose(np.linalg.det(cubemap.FRAMES), 1)


@pytest.mark.parametrize("layout", LAYOUTS)
def test_every_layout_gives_the_same_faces(layout):
    faces = faces_of(8)
    picture = laid_out(faces, layout)
    assert cubemap.is_cubemap(*picture.shape[:2])
    np.testing.assert_array_equal(cubemap.to_faces(picture), faces)


@pytest.mark.parametrize("layout", [(4, 3), (3, 4)])
def test_a_cross_is_seamless(layout):
    size = 32
    picture = laid_out(faces_of(size), layout)
    for axis in (0, 1):
        steps = np.abs(np.diff(picture, axis=axis))
        assert np.nanmax(steps) < 8 / size  # a face in the wrong place or turned jumps by 1 or more


@pytest.mark.parametrize(("height", "width"), [(512, 1024), (1, 1), (3, 5), (768, 1025), (0, 0)])
def test_other_shapes_are_no_cubemap(height, width):
    assert not cubemap.is_cubemap(height, width)
    with pytest.raises(ValueError, match="layout"):
        cubemap.to_faces(np.zeros((height, width, 3), np.float32))


@pytest.mark.parametrize(("size", "error"), [(1, 1e-9), (4, 1e-9), (16, 1e-11), (600, 1e-12)])
def test_a_constant_cubemap_is_a_constant(size, error):
    coefficients = cubemap.project(np.full((6, size, size, 3), 2, np.float32), 4)
    np.testing.assert_allclose(coefficients[0], 2 * np.sqrt(4 * np.pi), rtol=1e-13)
    assert np.abs(coefficients[1:]).max() < error


def test_energy_is_exact():
    faces = np.random.default_rng(0).random((6, 20, 20, 3), np.float32)
    weight = cubemap.solid_angles(20)[..., None]
    energy = (faces.astype(np.float64) * weight).sum(axis=(0, 1, 2))
    np.testing.assert_allclose(
        cubemap.project(faces, 1)[0] * np.sqrt(4 * np.pi), energy, rtol=1e-13
    )


def test_projection_is_the_sum_over_texel_centres():
    faces = np.random.default_rng(1).random((6, 40, 40, 3), np.float32)
    values = np.stack([sh.basis(cubemap.directions(face, 40), 5) for face in range(6)])
    expected = np.einsum("fyxi,fyxc,yx->ic", values, faces, cubemap.solid_angles(40))
    np.testing.assert_allclose(cubemap.project(faces, 5), expected, atol=2e-3)


@pytest.mark.parametrize("order", [2, 5, 7])
def test_cubemap_and_lat_long_of_one_radiance_agree(order):
    cube = cubemap.project(faces_of(192), order)
    sphere = lat_long.project(radiance(lat_long.directions(384, 768)).astype(np.float32), order)
    np.testing.assert_allclose(cube, sphere, atol=2e-4)


def test_a_finer_cubemap_is_closer_by_the_square():
    truth = lat_long.project(radiance(lat_long.directions(512, 1024)).astype(np.float32), 5)
    errors = [np.abs(cubemap.project(faces_of(size), 5) - truth).max() for size in (16, 32, 64)]
    assert errors[0] / errors[1] == pytest.approx(4, rel=0.15)
    assert errors[1] / errors[2] == pytest.approx(4, rel=0.15)


@pytest.mark.parametrize("size", [1, 5, 16, 64])
def test_a_cubemap_as_a_lat_long_map_is_the_same_light(size):
    faces = np.random.default_rng(size).random((6, size, size, 3), np.float32)
    faces[2, size // 3, size // 2] = 1e3  # a sun of one texel keeps its light
    expected = cubemap.project(faces, 5)
    found = lat_long.project(cubemap.to_lat_long(faces), 5)
    np.testing.assert_allclose(found[0], expected[0], rtol=1e-6)
    np.testing.assert_allclose(found, expected, atol=6e-3 * np.abs(expected).max())


def test_the_texels_of_a_cubemap_are_found_by_their_directions():
    found = [cubemap._texels_at(cubemap.directions(k, 9).reshape(-1, 3), 9) for k in range(6)]
    np.testing.assert_array_equal(np.concatenate(found), np.arange(6 * 81))


def test_a_constant_cubemap_is_a_constant_map():
    pixels = cubemap.to_lat_long(np.full((6, 32, 32, 3), 2, np.float32))
    assert abs(pixels.mean() - 2) < 2e-3
    assert np.abs(pixels - 2).max() < 0.5  # a texel's few places are no exact measure of it
