import numpy as np
import pytest
import scipy.special
from prt_baker.addon.prt import sh
from scipy.spatial.transform import Rotation

ORDERS = range(1, 9)
POLES = [(0, 0, 1), (0, 0, -1), (1, 0, 0), (0, -1, 0)]


def random_directions(count=200, seed=0):
    vectors = np.random.default_rng(seed).normal(size=(count, 3))
    return np.vstack([vectors / np.linalg.norm(vectors, axis=1, keepdims=True), POLES])


def random_rotations(count=5):
    return Rotation.random(count, random_state=1).as_matrix()


def complex_harmonic(band, m, theta, phi):
    if hasattr(scipy.special, "sph_harm_y"):
        return scipy.special.sph_harm_y(band, m, theta, phi)
    return scipy.special.sph_harm(m, band, phi, theta)


def scipy_basis(directions, order):
    x, y, z = directions.T
    theta, phi = np.arctan2(np.hypot(x, y), z), np.arctan2(y, x)
    columns = []
    for band in range(order):
        for m in range(-band, band + 1):
            value = complex_harmonic(band, abs(m), theta, phi) * (-1) ** m  # takes the phase away
            part = value.imag if m < 0 else value.real
            columns.append(part * (np.sqrt(2) if m else 1))
    return np.stack(columns, axis=-1)


def sphere_rule(order):
    z, weights = np.polynomial.legendre.leggauss(order + 3)
    phi = 2 * np.pi * np.arange(2 * order + 5) / (2 * order + 5)
    sine = np.sqrt(1 - z * z)[:, None]
    xyz = [sine * np.cos(phi), sine * np.sin(phi), z[:, None] + 0 * phi]
    each = np.repeat(weights * 2 * np.pi / len(phi), len(phi))
    return np.stack(xyz, axis=-1).reshape(-1, 3), each


def test_index_counts_the_coefficients_band_by_band():
    places = [sh.index(band, m) for band in range(8) for m in range(-band, band + 1)]
    assert places == list(range(64))


@pytest.mark.parametrize("order", ORDERS)
def test_basis_is_scipys_without_the_condon_shortley_phase(order):
    directions = random_directions()
    expected = scipy_basis(directions, order)
    np.testing.assert_allclose(sh.basis(directions, order), expected, rtol=0, atol=1e-12)


def test_the_first_band_grows_with_its_axes():
    at_x, at_y, at_z = sh.basis(np.eye(3), 2) / np.sqrt(3 / (4 * np.pi))
    places = [sh.index(1, m) for m in (1, -1, 0)]
    np.testing.assert_allclose([at_x[places], at_y[places], at_z[places]], np.eye(3), atol=1e-15)


@pytest.mark.parametrize("order", ORDERS)
def test_basis_is_orthonormal(order):
    directions, weights = sphere_rule(order)
    values = sh.basis(directions, order)
    gram = values.T @ (weights[:, None] * values)
    np.testing.assert_allclose(gram, np.eye(order**2), atol=1e-13)


def test_basis_keeps_the_shape_of_its_directions():
    directions = random_directions()[:12].reshape(3, 4, 3)
    values = sh.basis(directions, 4)
    assert values.shape == (3, 4, 16)
    np.testing.assert_array_equal(values[1, 2], sh.basis(directions[1, 2], 4))


@pytest.mark.parametrize("order", ORDERS)
def test_a_turned_function_has_the_old_values_at_turned_directions(order):
    coefficients = np.random.default_rng(order).normal(size=(order**2, 3))
    directions = random_directions()
    for rotation in random_rotations():
        turned = sh.evaluate(sh.rotate(coefficients, rotation), directions @ rotation.T)
        np.testing.assert_allclose(turned, sh.evaluate(coefficients, directions), atol=1e-12)


def test_rotations_compose_and_keep_the_norm():
    first, second = random_rotations(2)
    one, other = (sh.rotation_matrix(rotation, 6) for rotation in (first, second))
    np.testing.assert_allclose(sh.rotation_matrix(first @ second, 6), one @ other, atol=1e-13)
    np.testing.assert_allclose(one @ one.T, np.eye(36), atol=1e-13)


def test_rotation_does_not_mix_bands():
    matrix = sh.rotation_matrix(random_rotations(1)[0], 6)
    band = sh.bands(6)
    assert np.abs(matrix[band[:, None] != band]).max() < 1e-13


def test_a_reflection_turns_functions_too():
    mirror = np.diag([-1.0, 1, 1]) @ random_rotations(1)[0]
    coefficients = np.random.default_rng(2).normal(size=25)
    directions = random_directions()
    mirrored = sh.evaluate(sh.rotate(coefficients, mirror), directions @ mirror.T)
    np.testing.assert_allclose(mirrored, sh.evaluate(coefficients, directions), atol=1e-12)


def test_a_quarter_turn_about_z_takes_x_to_y():
    quarter = np.array([[0, -1, 0], [1, 0, 0], [0, 0, 1]])
    along_x = np.zeros(4)
    along_x[sh.index(1, 1)] = 1
    expected = np.zeros(4)
    expected[sh.index(1, -1)] = 1
    np.testing.assert_allclose(sh.rotate(along_x, quarter), expected, atol=1e-15)


def test_clamped_cosine_is_the_projection_of_max_z_0():
    z, weights = np.polynomial.legendre.leggauss(40)
    z, weights = 0.5 * (z + 1), 0.5 * weights  # the upper half alone, where it is smooth
    meridian = np.stack([np.sqrt(1 - z * z), 0 * z, z], axis=-1)
    projection = 2 * np.pi * (weights * z) @ sh.basis(meridian, 8)
    zonal = [sh.index(band, 0) for band in range(8)]
    at_pole = sh.basis([0, 0, 1], 8)[zonal]
    np.testing.assert_allclose(sh.clamped_cosine(8) * at_pole, projection[zonal], atol=1e-13)


def test_clamped_cosine_has_the_closed_forms():
    expected = [np.pi, 2 * np.pi / 3, np.pi / 4, 0, -np.pi / 24]
    np.testing.assert_allclose(sh.clamped_cosine(5), expected, atol=1e-14)


def test_a_white_sky_makes_an_open_white_surface_white():
    sky = np.zeros(25)
    sky[0] = np.sqrt(4 * np.pi)
    np.testing.assert_allclose(sh.open_transfer(random_directions(), 5) @ sky, 1, atol=1e-14)


def test_bands_say_which_band_a_coefficient_is_of():
    assert sh.bands(3).tolist() == [0, 1, 1, 1, 2, 2, 2, 2, 2]


@pytest.mark.parametrize("count", [2, 3, 8, 24, 26])
def test_a_number_of_coefficients_is_a_square(count):
    assert sh.order_of(25) == 5
    with pytest.raises(ValueError, match="square"):
        sh.order_of(count)
