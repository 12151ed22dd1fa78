"""How much of a baked residual belongs to the light of now, from spherical harmonics alone.

A residual is what the transfer misses of the exact exit radiance of a white surface, for the light
that it was baked under.  The further the light departs from that one, the less of it is shown.
Angles about Z turn the world: residual k of N belongs to the baked light turned by ``2 pi k / N``.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from math import cos, pi

import numpy as np
import numpy.typing as npt

from .. import sh
from ..job import LIGHT_ORDER, Peak
from ..layout import Values

Float = npt.NDArray[np.float64]

SHARPNESS = 16  # how fast a residual fades as the light turns: gone at about 20 degrees
DIRECTED = slice(1, 9)  # l = 1 .. 2: what of the light has a direction and varies slowly
NOTHING = 1e-6  # of a light's norm: what is less has no direction


@dataclass(frozen=True)
class Terms:
    """What the stored values are multiplied by: the exit radiance of a white surface under a light
    L is ``sum T_i (L_i - cut_out_i) + sum R_k residual_k + sum S_j lights_j``, clamped at 0.

    ``cut_out`` (n², 3) is the part of L that ``lights`` (lights, 3) bring back with hard shadows;
    ``residual`` (turns, 3) are weights.
    """

    residual: Float
    lights: Float
    cut_out: Float


def weight(radiance_sh: npt.ArrayLike, baked_sh: npt.ArrayLike) -> Float:
    """How much (3) of the residual of ``baked_sh`` (n², 3) is shown under ``radiance_sh`` (n², 3).

    In each channel c the ratio of the lights' norms over all coefficients, times
    ``max(0, rho)^16``; rho is the cosine between the lights over l = 1 .. 2 and all channels
    together.  0 where the baked light has nothing in that channel.
    """
    now, baked = np.asarray(radiance_sh, np.float64), np.asarray(baked_sh, np.float64)
    strength = np.linalg.norm(baked, axis=0)
    ratio = np.zeros(3)
    np.divide(np.linalg.norm(now, axis=0), strength, out=ratio, where=strength > 0)
    return np.asarray(ratio * likeness(now, baked))


def likeness(radiance_sh: npt.ArrayLike, baked_sh: npt.ArrayLike) -> float:
    """``max(0, rho)^16``: 1 where the lights differ in strength alone, 0 where nothing is left."""
    now, baked = np.asarray(radiance_sh, np.float64), np.asarray(baked_sh, np.float64)
    return float(max(0.0, _cosine(now, baked)) ** SHARPNESS)


def turn_weights(radiance_sh: npt.ArrayLike, baked_sh: npt.ArrayLike, turns: int) -> Float:
    """How much (turns, 3) of each of the residuals for ``turns`` turns of ``baked_sh`` is shown.

    One residual: ``weight``.  Several: the two beside the angle about Z that best takes the baked
    light to ``radiance_sh``, blended linearly by the angle, times the weight against the baked
    light turned by it.
    """
    if turns < 2:
        return np.tile(weight(radiance_sh, baked_sh), (turns, 1))
    angle = turn_angle(radiance_sh, baked_sh)
    place = angle / (2 * pi) * turns
    before = int(place) % turns
    share = place - int(place)
    whole = weight(radiance_sh, turned(baked_sh, angle))
    weights = np.zeros((turns, 3))
    weights[before] = (1 - share) * whole
    weights[(before + 1) % turns] += share * whole
    return weights


def terms(
    radiance_sh: npt.ArrayLike, baked_sh: npt.ArrayLike, turns: int, peaks: tuple[Peak, ...]
) -> Terms:
    """What a bake of ``turns`` residuals and ``peaks`` is multiplied by under ``radiance_sh``;
    it and ``baked_sh`` (n², 3) have their peaks.

    The peaks fade with the first residual, which is the one of the world as it was baked: where
    none of it is shown, the whole light is in the coefficients.
    """
    residual = turn_weights(radiance_sh, baked_sh, max(1, turns))
    shown = residual[0]
    irradiance = np.array([peak.irradiance for peak in peaks]).reshape(-1, 3)
    return Terms(residual[:turns], shown * irradiance / pi, shown * peaks_sh(peaks))


def beyond(values: Values, by: Terms, share: float = 1.0) -> Float:
    """Exit radiance (E, 3) of a white surface that ``values`` add to their transfer's, the light
    being that of ``by``; of the residual a ``share`` is shown, and nothing else where that is 0."""
    total = share * np.einsum("ekc,kc->ec", values.residual, by.residual)
    if share and len(by.lights):
        total += values.visibility @ by.lights - shaded(values.transfer, by.cut_out)
    return np.asarray(total)


def shaded(transfer: npt.NDArray[np.float32], radiance_sh: Float) -> Float:
    """Exit radiance (E, 3) of a white surface: ``transfer`` (E, channels, n²) times light."""
    three = np.broadcast_to(transfer, (len(transfer), 3, transfer.shape[2]))
    return np.asarray(np.einsum("eci,ic->ec", three, radiance_sh[: transfer.shape[2]]))


@lru_cache(maxsize=16)
def peaks_sh(peaks: tuple[Peak, ...]) -> Float:
    """Coefficients (25, 3) of ``peaks``, each a disc of constant radiance; not to be changed.

    A disc of radius a about the pole, that gives a surface facing it the irradiance 1, has the
    zonal integrals ``2 / (1 + cos a)`` for l = 0 and ``2 P_l'(cos a) / (l (l + 1))`` beyond:
    no difference of nearly equal numbers, so a may be 0.
    """
    total = np.zeros((LIGHT_ORDER**2, 3))
    for peak in peaks:
        direction = np.asarray(peak.direction, np.float64)
        values = sh.basis(direction / np.linalg.norm(direction), LIGHT_ORDER)
        zonal = _disc(cos(peak.angular_radius))[sh.bands(LIGHT_ORDER)]
        total += np.outer(values * zonal, peak.irradiance)
    return total


def turned(coefficients: npt.ArrayLike, angle: float) -> Float:
    """Light (n², 3) turned about Z by ``angle``, from +x towards +y."""
    values = np.asarray(coefficients, np.float64)
    result = values.copy()
    for l in range(1, sh.order_of(len(values))):  # noqa: E741
        m = np.arange(1, l + 1)
        cosine, sine = np.cos(m * angle)[:, None], np.sin(m * angle)[:, None]
        even, odd = values[sh.index(l, 0) + m], values[sh.index(l, 0) - m]
        result[sh.index(l, 0) + m] = cosine * even - sine * odd
        result[sh.index(l, 0) - m] = sine * even + cosine * odd
    return result


def turn_angle(radiance_sh: npt.ArrayLike, baked_sh: npt.ArrayLike) -> float:
    """The angle about Z, 0 up to 2 pi, by which ``baked_sh`` (n², 3) has to be turned to come
    nearest to ``radiance_sh`` (n², 3) over l = 1 .. 2.

    Their product is ``c_0 + Re(c_1 z + c_2 z²)`` at ``z = exp(i angle)``; its extremes are the
    roots of a polynomial of degree 4.
    """
    now = np.asarray(radiance_sh, np.float64)[DIRECTED]
    baked = np.asarray(baked_sh, np.float64)[DIRECTED]
    first = _harmonic(now, baked, ((1, 1), (2, 1)))
    second = _harmonic(now, baked, ((2, 2),))
    if abs(first) + abs(second) <= NOTHING * float(np.linalg.norm(now) * np.linalg.norm(baked)):
        return 0.0
    slope = (2 * second, first, 0, -np.conj(first), -2 * np.conj(second))
    angles = np.angle(np.roots(slope))
    product = np.real(first * np.exp(1j * angles) + second * np.exp(2j * angles))
    return float(angles[np.argmax(product)] % (2 * pi))


def _harmonic(now: Float, baked: Float, pairs: Sequence[tuple[int, int]]) -> complex:
    """The factor of ``exp(i m angle)`` in the product of ``now`` and the turned ``baked``, both
    (8, 3), of the coefficients ``pairs`` (l, m)."""
    total = 0j
    for l, m in pairs:  # noqa: E741
        even, odd = sh.index(l, m) - 1, sh.index(l, -m) - 1
        aligned = (now[even] * baked[even] + now[odd] * baked[odd]).sum()
        across = (now[odd] * baked[even] - now[even] * baked[odd]).sum()
        total += complex(aligned, -across)
    return total


def _cosine(now: Float, baked: Float) -> float:
    """The cosine between two lights (n², 3) over l = 1 .. 2.  1 where neither has a direction, 0
    where one has none."""
    now_directed, baked_directed = now[DIRECTED], baked[DIRECTED]
    lengths = np.linalg.norm(now_directed), np.linalg.norm(baked_directed)
    faint = [
        length <= NOTHING * np.linalg.norm(light)
        for length, light in zip(lengths, (now, baked), strict=True)
    ]
    if any(faint):
        return float(all(faint))
    return float((now_directed * baked_directed).sum() / (lengths[0] * lengths[1]))


def _disc(x: float) -> Float:
    """Zonal integrals (5) of a disc whose rim is at ``x``, the cosine of its radius, and that gives
    a facing surface the irradiance 1."""
    integrals = np.empty(LIGHT_ORDER)
    integrals[0] = 2 / (1 + x)
    for l in range(1, LIGHT_ORDER):  # noqa: E741
        slope = np.polynomial.legendre.Legendre.basis(l).deriv()(x)
        integrals[l] = 2 * slope / (l * (l + 1))
    return integrals
