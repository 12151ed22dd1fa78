"""The microfacet model: GGX D, Schlick-GGX G, Schlick F.

``roughness`` r is Principled's.  D's alpha is r²; G's k is r²/2 where the light comes from all
around and (r + 1)²/8 for a single light.  Cosines are between unit vectors, of the normal n with
the half vector h, the light l and the viewer v.
"""

import numpy as np
import numpy.typing as npt

Float = npt.NDArray[np.float64]


def distribution(alpha: npt.ArrayLike, n_h: npt.ArrayLike) -> Float:
    """GGX D (sr⁻¹): the integral of ``D n_h`` over the hemisphere is 1."""
    squared = np.square(np.asarray(alpha, np.float64))
    cosine = np.square(np.asarray(n_h, np.float64))
    # sin² + alpha² cos²: as (alpha² - 1) cos² + 1 it loses all digits at the peak
    return np.asarray(squared / (np.pi * np.square((1 - cosine) + squared * cosine)))


def masking(k: npt.ArrayLike, cosine: npt.ArrayLike) -> Float:
    """Schlick's share of the microfacets that one direction sees; G is that of two."""
    cosine = np.asarray(cosine, np.float64)
    return np.asarray(cosine * visible_part(k, cosine))


def visible_part(k: npt.ArrayLike, cosine: npt.ArrayLike) -> Float:
    """``masking`` over the cosine, finite at the horizon."""
    k = np.asarray(k, np.float64)
    return np.asarray(1 / (np.asarray(cosine, np.float64) * (1 - k) + k))


def environment_k(roughness: npt.ArrayLike) -> Float:
    """The k of light from all around."""
    return np.asarray(np.square(np.asarray(roughness, np.float64)) / 2)


def light_k(roughness: npt.ArrayLike) -> Float:
    """The k of a single light."""
    return np.asarray(np.square(np.asarray(roughness, np.float64) + 1) / 8)


def fresnel_part(v_h: npt.ArrayLike) -> Float:
    """``Fc`` of ``F = F0 (1 - Fc) + F90 Fc``."""
    return np.asarray((1 - np.asarray(v_h, np.float64)) ** 5)


def lobe(roughness: npt.ArrayLike, cosine: npt.ArrayLike) -> Float:
    """What radiance is filtered with, at the cosine of the angle to the look-up direction, not
    normalised: ``D cos`` with n = v = r, so that h lies half way; 0 behind."""
    cosine = np.asarray(cosine, np.float64)
    alpha = np.square(np.asarray(roughness, np.float64))
    n_h = np.sqrt(np.maximum(0, 0.5 * (1 + cosine)))
    return np.asarray(distribution(alpha, n_h) * np.maximum(cosine, 0))
