"""Rays that slipped between two triangles, found where they would show.

Embree's fast mode lets about one ray in four million through the edges of a closed mesh.  Among the
clear rays of a point in the open that is nothing; at a point that sees next to no sky it is a speck
of light.  So there each ray that came through is cast once more, in the robust mode.
"""

import numpy as np
import numpy.typing as npt

from .rays import Occlusion

Array = npt.NDArray[np.float32]

NEARLY_DARK = 1 / 32  # of the rays reach the sky


def doubtful(visible: Array, occlusion: Occlusion) -> npt.NDArray[np.bool_]:
    """Which points, of ``visible`` (P, N), 1 or 0, see so little that one ray too many would
    show; none where none can slip."""
    if not occlusion.lets_slip:
        return np.zeros(len(visible), bool)
    return np.asarray(visible.sum(axis=1) <= NEARLY_DARK * visible.shape[1])


def confirmed(occlusion: Occlusion, origins: Array, directions: Array) -> Array:
    """Which of the rays (R, 3) reach the sky for certain, 1 or 0."""
    if not len(directions):
        return np.zeros(0, np.float32)
    return -occlusion.watertight().sky_mask(origins, directions).astype(np.float32)
