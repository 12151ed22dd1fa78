"""Where filtered radiance is read, against series of harmonics and sums that know no potential."""

import numpy as np
import pytest
from numpy.polynomial.legendre import leggauss, legval
from prt_baker.addon.prt.specular import brdf, look_up, table

BANDS = 120


def means(values, weights, cosines, bands=BANDS):
    """Of the Legendre polynomials under ``values`` at ``cosines``."""
    weighed = values * weights / (values @ weights)
    return np.array([weighed @ legval(cosines, np.eye(bands)[band]) for band in range(bands)])


@pytest.mark.parametrize("roughness", [0.45, 0.7, 1.0, 1.15])
def test_a_potential_is_its_series(roughness):
    """-log x is 1 plus the sum of (2 l + 1) / (l (l + 1)) P_l."""
    nodes, weights = leggauss(1200)
    cosines = 0.5 * (nodes + 1)
    factors = means(brdf.lobe(roughness, cosines), weights, cosines)
    band = np.arange(1, BANDS)
    terms = np.concatenate([[1.0], (2 * band + 1) / (band * (band + 1)) * factors[1:]])
    x = np.linspace(0, 1, 41)
    found = look_up.Potential.of(roughness)
    assert found(x) == pytest.approx(legval(1 - 2 * x, terms), abs=2e-3)
    assert found.energy == pytest.approx(terms @ factors, abs=2e-3)


def test_the_chosen_lobe_has_the_smallest_error():
    """Among its neighbours, by the difference of coefficients, band by band."""
    roughness, n_v = 0.7, 0.5
    lobe = table.Lobe.of(roughness, n_v)
    weights = lobe.weights / lobe.weights.sum()
    nodes, gauss = leggauss(2000)
    cosines = 0.5 * (nodes + 1)
    bands = np.arange(1, 60)

    def error(share, ratio):
        factors = means(brdf.lobe(ratio * roughness, cosines), gauss, cosines, 60)[1:]
        axis = np.array([-(1 - share) * np.sqrt(1 - n_v**2), (1 - share) * n_v + share])
        towards = np.stack([lobe.x_l, lobe.n_l], axis=1) @ (axis / np.linalg.norm(axis))
        along = np.array([weights @ legval(towards, np.eye(60)[band]) for band in bands])
        share_of_band = (2 * bands + 1) / (bands * (bands + 1))
        return (share_of_band * factors * (factors - 2 * along)).sum()

    share, ratio = look_up.best(roughness, n_v)
    least = error(share, ratio)
    for aside in (-0.04, 0.04):
        assert error(share + aside, ratio) > least
        assert error(share, ratio + aside) > least


def test_sharp_lobes_stay_about_the_mirrored_direction_and_the_roughest_lie_about_the_normal():
    for n_v in (0.2, 0.6, 0.95):
        share, ratio = look_up.best(0.05, n_v)
        assert share < 1e-3
        assert 0.7 < ratio <= 1.01
        assert look_up.best(1.0, n_v) == pytest.approx((1, look_up.ROUGHEST), abs=0.01)
    assert look_up.best(0.05, 0.99)[1] == pytest.approx(1, abs=0.02)


def test_the_shipped_nodes_are_what_the_engine_computes():
    nodes, last = np.load(look_up.FILE), look_up.SIZE - 1
    assert nodes.shape == (look_up.SIZE, look_up.SIZE, 2)
    for row, column in ((3, 20), (12, 5), (20, 28), (27, 2)):
        found = look_up.best(row / last, (column / last) ** 2)
        assert nodes[row, column] == pytest.approx(found, abs=1e-5)
    assert (np.diff(nodes[..., 0], axis=0) >= -0.01).all()  # the rougher, the more bent
