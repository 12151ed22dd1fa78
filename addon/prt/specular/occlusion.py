"""How much of what a surface reflects reaches it, from what is baked at a point.

    share = (1 - r²) lobe + r² arriving
    lobe     = clip(sum V_lm z_l Y_lm(R), 0, 1)
    arriving = clip(sum T_i M_i / sum O_i M_i, 0, 1), channel by channel

V is the visibility, R the look-up direction, z_l the zonal factors of the lobe that the light there
is filtered with; T is the transfer, O that of the open surface with the same normal, M the light
that is reflected.

A sharp lobe asks where it points, and the visibility tells that.  A wide one asks for the light, as
no share of the lobe says whether the sun stands before a wall or behind it.  At r = 1 the lobe is
nearly the cosine about the normal, so there the share is that of the diffuse light, which is baked.
"""

from functools import lru_cache

import numpy as np
import numpy.typing as npt

from .. import sh

Float = npt.NDArray[np.float64]

FAINTEST = 0.05  # of the mean irradiance: a truncated light may be darker, and negative
FACINGS = 500  # among which the darkest is looked for


def share(lobe: npt.ArrayLike, arriving: npt.ArrayLike, roughness: npt.ArrayLike) -> Float:
    """The share (P, 3) of the reflected radiance: ``lobe`` (P,) and ``arriving`` (P, 3), blended by
    the ``roughness`` (P,) or ()."""
    seen, lit = np.asarray(lobe, np.float64)[:, None], np.asarray(arriving, np.float64)
    squared = np.square(np.asarray(roughness, np.float64)).reshape(-1, 1)
    return np.asarray(seen + squared * (lit - seen))


def occlusion(
    visibility_sh: npt.ArrayLike, directions: npt.ArrayLike, factors: npt.ArrayLike
) -> Float:
    """The share (P,) of lobes about unit ``directions`` (P, 3) that is seen, 0 to 1, where
    ``visibility_sh`` (P, v²) is: both are cut off at V's order.

    ``factors`` (P, v), or of more bands or of one lobe for all, are the lobes' zonal factors, the
    first of them 1.
    """
    seen = np.asarray(visibility_sh, np.float64)
    order = sh.order_of(seen.shape[-1])
    bands = np.asarray(factors, np.float64)[..., sh.bands(order)]
    return np.clip((seen * bands * sh.basis(directions, order)).sum(axis=-1), 0, 1)


def arriving(transfer: npt.ArrayLike, normals: npt.ArrayLike, light: npt.ArrayLike) -> Float:
    """The share (P, 3) of the open surface's irradiance that arrives, 0 to 1, where ``transfer``
    (P, channels, n²) is baked for unit ``normals`` (P, 3), under a ``light`` of ``brightened``."""
    baked, radiance = np.asarray(transfer, np.float64), np.asarray(light, np.float64)
    count = baked.shape[-1]
    found = np.einsum("pci,ic->pc", np.repeat(baked, 3 // baked.shape[1], axis=1), radiance[:count])
    whole = sh.open_transfer(normals, sh.order_of(count)) @ radiance[:count]
    ratio = np.divide(found, whole, out=np.zeros_like(found), where=whole > 0)  # as nodes divide
    return np.asarray(np.clip(ratio, 0, 1))


def brightened(radiance_sh: npt.ArrayLike, order: int) -> Float:
    """``radiance_sh`` (n², 3) in ``order`` bands with so much more light from everywhere that an
    open surface gets at least FAINTEST of the mean irradiance, whichever way it faces."""
    light = np.array(radiance_sh, np.float64)[: order**2]
    mean = _open_transfers(1)[0] @ light[:1]
    darkest = (_open_transfers(order) @ light).min(axis=0)
    light[0] += np.maximum(0, FAINTEST * mean - darkest) / _open_transfers(1)[0, 0]
    return light


@lru_cache(maxsize=8)
def _open_transfers(order: int) -> Float:
    """Of surfaces that face every way, evenly (D, n²)."""
    i = np.arange(FACINGS)
    z, phi = 1 - (2 * i + 1) / FACINGS, i * np.pi * (3 - np.sqrt(5))
    radius = np.sqrt(1 - z * z)
    facing = np.stack([radius * np.cos(phi), radius * np.sin(phi), z], axis=1)
    return sh.open_transfer(facing, order)
