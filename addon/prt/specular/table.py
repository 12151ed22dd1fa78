"""The table of the split sum: how much of the light about the mirrored direction leaves.

    A = integral of D G / (4 n_l n_v) (1 - Fc) n_l over l,   B = the same of Fc

so that under a constant radiance 1 the specular exit radiance is ``F0 A + F90 B``.  Nodes of the
grid are at equal steps of the roughness and of sqrt(n_v), both from 0 to 1.  ``table.npy`` beside
this module holds it as ``compute`` makes it.
"""

from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import numpy as np
import numpy.typing as npt

from ..parallel import workers
from . import brdf

Float = npt.NDArray[np.float64]
SIZE = 128
FILE = Path(__file__).with_name("table.npy")
GAUSS = 64  # nodes along each of the two angles of a piece
SMOOTHEST = 1e-3  # stands for a roughness that falls to 0
SMALLEST_COSINE = 1e-9  # stands for grazing, where the limit is taken


@dataclass(frozen=True)
class Lobe:
    """Light directions that a white surface reflects to a viewer in the plane of x and z, z its
    normal: their cosines ``n_l`` and ``x_l`` (Q,) to z and x, for one half of them; how much each
    one counts where the Fresnel factor is 1, ``weights`` (Q,); and ``fresnel`` (Q,), its Fc."""

    n_l: Float
    x_l: Float
    weights: Float
    fresnel: Float

    @classmethod
    def of(cls, roughness: float, n_v: float, count: int = GAUSS) -> "Lobe":
        """By Gauss-Legendre over the half vector h, for roughness above 0; the viewer's x is
        positive.

        With ``tan theta = alpha tan t`` D's peak is as wide as any other in t.  For a given theta,
        l is above the horizon up to an azimuth that is known exactly; it is a whole turn until
        ``theta = (pi / 2 - theta_v) / 2``, and none from ``(pi / 2 + theta_v) / 2`` on.  These two
        are the ends of pieces, as the azimuth has infinite slope there.
        """
        n_v = max(n_v, SMALLEST_COSINE)
        alpha, theta_v = roughness**2, float(np.arccos(n_v))
        bounds = [np.arctan(np.tan((np.pi / 2 + s * theta_v) / 2) / alpha) for s in (-1, 1)]
        nodes, weights = _clustered(count)
        pieces = []
        for low, high in ((0.0, bounds[0]), (bounds[0], bounds[1])):
            t = low + (high - low) * nodes
            theta = np.arctan(alpha * np.tan(t))
            measure = 2 * np.sin(t) * np.cos(t) * weights * (high - low)  # of D n_h, azimuths apart
            pieces.append(_over_azimuth(roughness, n_v, theta, measure, nodes, weights))
        return cls(*(np.concatenate(parts) for parts in zip(*pieces, strict=True)))


def split_sum(roughness: float, n_v: float, count: int = GAUSS) -> tuple[float, float]:
    """``A`` and ``B``."""
    if roughness == 0:
        fresnel = float(brdf.fresnel_part(n_v))
        return 1 - fresnel, fresnel
    lobe = Lobe.of(roughness, n_v, count)
    edge = float(lobe.weights @ lobe.fresnel)
    return float(lobe.weights.sum()) - edge, edge


def compute(size: int = SIZE) -> npt.NDArray[np.float32]:
    """A and B (size, size, 2) at the nodes: rows of one roughness, columns of one cosine.

    At roughness 0 and grazing there is no one limit; the node there has that of grazing light as
    the roughness falls, so that silhouettes of smooth things are read right.
    """
    steps = np.linspace(0, 1, size)

    def row(roughness: float) -> list[tuple[float, float]]:
        return [split_sum(roughness, step**2) for step in steps]

    with workers(0) as pool:
        rows = list(pool.map(row, [float(step) for step in steps]))
    rows[0][0] = split_sum(SMOOTHEST, 0.0)
    return np.array(rows, np.float32)


@lru_cache(maxsize=1)
def load() -> npt.NDArray[np.float32]:
    """A and B (SIZE, SIZE, 2) as shipped."""
    table: npt.NDArray[np.float32] = np.load(FILE)
    table.flags.writeable = False
    return table


def bilinear(table: npt.ArrayLike, roughness: npt.ArrayLike, n_v: npt.ArrayLike) -> Float:
    """``A`` and ``B`` (P, 2) between the nodes of ``table`` (n, n, 2)."""
    values = np.asarray(table, np.float64)
    places = [np.asarray(roughness, np.float64), np.sqrt(np.asarray(n_v, np.float64))]
    scaled = [np.clip(place, 0, 1) * (len(values) - 1) for place in places]
    row, column = (np.minimum(place.astype(np.int64), len(values) - 2) for place in scaled)
    down, right = (scaled[0] - row)[:, None], (scaled[1] - column)[:, None]
    first = values[row, column] * (1 - right) + values[row, column + 1] * right
    second = values[row + 1, column] * (1 - right) + values[row + 1, column + 1] * right
    return np.asarray(first * (1 - down) + second * down)


def _over_azimuth(  # noqa: PLR0917 - a piece of Lobe.of
    roughness: float, n_v: float, theta: Float, measure: Float, nodes: Float, weights: Float
) -> tuple[Float, Float, Float, Float]:
    """The fields of a Lobe for half vectors at ``theta`` (T,), each with its ``measure``."""
    cosine, sine = np.cos(theta)[:, None], np.sin(theta)[:, None]
    s_v = np.sqrt(1 - n_v * n_v)
    with np.errstate(divide="ignore", invalid="ignore"):
        edge = -n_v * np.cos(2 * theta) / (s_v * np.sin(2 * theta))
    from_above = -np.copysign(1, np.cos(2 * theta))  # where v is the normal
    furthest = np.arccos(np.clip(np.where(s_v > 0, edge, from_above), -1, 1))
    along = np.cos(furthest[:, None] * nodes)
    v_h = np.clip(s_v * sine * along + n_v * cosine, 0, 1)
    n_l = np.maximum(2 * v_h * cosine - n_v, 0)
    k = float(brdf.environment_k(roughness))
    value = brdf.masking(k, n_l) * brdf.visible_part(k, n_v) * v_h / cosine
    value *= weights * (measure * furthest / np.pi)[:, None]
    x_l = 2 * v_h * sine * along - s_v
    return n_l.ravel(), x_l.ravel(), value.ravel(), brdf.fresnel_part(v_h).ravel()


@lru_cache(maxsize=4)
def _clustered(count: int) -> tuple[Float, Float]:
    """Nodes and weights of Gauss-Legendre on [0, 1], crowded at both ends."""
    nodes, weights = np.polynomial.legendre.leggauss(count)
    angle = np.pi / 4 * (nodes + 1)
    return np.sin(angle) ** 2, weights * np.pi / 4 * np.sin(2 * angle)
