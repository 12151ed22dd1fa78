"""How much of a reflection's lobe reaches the sky, from what a point sees.

The lobe is about the look-up direction R, the visibility V a function on the sphere, so the share
of it that is seen is one sum over coefficients: both are cut off at V's order, which a lobe wider
than that order's detail hardly notices.
"""

import numpy as np
import numpy.typing as npt

from .. import sh

Float = npt.NDArray[np.float64]


def occlusion(
    visibility_sh: npt.ArrayLike, directions: npt.ArrayLike, factors: npt.ArrayLike
) -> Float:
    """The share (P,) of lobes about unit ``directions`` (P, 3) that is seen, 0 to 1, where
    ``visibility_sh`` (P, v²) is.

    ``factors`` (P, v), or of more bands or of one lobe for all, are the lobes' zonal factors, the
    first of them 1: ``sum V_lm z_l Y_lm(R)``.
    """
    seen = np.asarray(visibility_sh, np.float64)
    order = sh.order_of(seen.shape[-1])
    bands = np.asarray(factors, np.float64)[..., sh.bands(order)]
    return np.clip((seen * bands * sh.basis(directions, order)).sum(axis=-1), 0, 1)
