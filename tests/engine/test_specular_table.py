"""The BRDF and its table against integration that knows nothing of how they are computed."""

import numpy as np
import pytest
from prt_baker.addon.prt.specular import brdf, table
from scipy.integrate import dblquad, quad

SHIPPED = table.load()


def by_light(roughness, n_v):
    """A and B by adaptive integration over the light's direction, about the mirrored one."""
    alpha, k, s_v = roughness**2, roughness**2 / 2, np.sqrt(1 - n_v**2)
    mirrored = np.array([-s_v, 0.0, n_v])
    across = np.array([n_v, 0.0, s_v])

    def value(azimuth, t, power):
        angle = 4 * alpha * np.sinh(t)  # crowds at the peak
        l = np.cos(angle) * mirrored + np.sin(angle) * (  # noqa: E741
            np.cos(azimuth) * across + np.sin(azimuth) * np.array([0, 1, 0])
        )
        if l[2] <= 0:
            return 0.0
        h = l + np.array([s_v, 0, n_v])
        h /= np.linalg.norm(h)
        v_h, n_h = h[0] * s_v + h[2] * n_v, h[2]
        d = alpha**2 / (np.pi * (n_h**2 * (alpha**2 - 1) + 1) ** 2)
        g = l[2] / (l[2] * (1 - k) + k) * n_v / (n_v * (1 - k) + k)
        fc = (1 - v_h) ** 5
        split = fc if power else 1 - fc
        return d * g / (4 * n_v) * split * np.sin(angle) * 4 * alpha * np.cosh(t)

    end = np.arcsinh(np.pi / (4 * alpha))
    parts = (
        dblquad(value, 0, end, 0, np.pi, args=(power,), epsabs=2e-6, epsrel=1e-5)[0]
        for power in (0, 1)
    )
    return 2 * np.array([*parts])


@pytest.mark.parametrize("alpha", [0.01, 0.2, 1.0])
def test_microfacets_cover_the_surface(alpha):
    def covered(t):  # tan(theta) = alpha tan(t)
        theta = np.arctan(alpha * np.tan(t))
        slope = alpha / np.cos(t) ** 2 * np.cos(theta) ** 2
        return brdf.distribution(alpha, np.cos(theta)) * np.cos(theta) * np.sin(theta) * slope

    assert 2 * np.pi * quad(covered, 0, np.pi / 2)[0] == pytest.approx(1, abs=1e-5)


@pytest.mark.parametrize(("row", "column"), [(50, 70), (127, 127), (90, 30), (127, 20)])
def test_the_table_is_adaptive_integration(row, column):
    roughness, n_v = row / 127, (column / 127) ** 2
    assert SHIPPED[row, column] == pytest.approx(by_light(roughness, n_v), abs=1e-4)


def test_normal_incidence_of_the_roughest_has_a_closed_form():
    assert SHIPPED[-1, -1].sum() == pytest.approx((1 - np.log(2)), abs=1e-6)


def test_the_shipped_table_is_what_the_engine_computes():
    for row, column in ((0, 64), (1, 0), (1, 1), (3, 2), (40, 0), (64, 100), (127, 3)):
        exact = table.split_sum(row / 127, (column / 127) ** 2, count=200)
        assert SHIPPED[row, column] == pytest.approx(exact, abs=1e-5)
    grazing = table.split_sum(1e-3, 0.0, count=200)
    assert SHIPPED[0, 0] == pytest.approx(grazing, abs=1e-5)
    assert SHIPPED.shape == (table.SIZE, table.SIZE, 2)
    assert SHIPPED.sum(axis=-1).max() <= 1 + 1e-6


def test_bilinear_reads_are_near():
    roughness, n_v = np.random.default_rng(1).random((2, 10_000))
    roughness[:200], n_v[200:400] = 0, 0
    exact = [table.split_sum(r, c, count=24) for r, c in zip(roughness, n_v, strict=True)]
    error = np.abs(table.bilinear(SHIPPED, roughness, n_v) - exact).max(axis=1)
    assert np.quantile(error, 0.99) < 2e-3
    assert error.max() < 1.5e-2


def test_a_mirror_returns_everything_of_white():
    cosines = np.linspace(1e-4, 1, 50)
    read = table.bilinear(SHIPPED, np.zeros(50), cosines)
    assert read.sum(axis=1) == pytest.approx(np.ones(50), abs=1e-6)
