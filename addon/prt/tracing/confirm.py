"""Rays that slipped between two triangles, found where they would show.

Embree's fast mode lets about one ray in four million through the edges of a closed mesh.  Among the
clear rays of a point in the open that is nothing; at a point that sees next to no sky it is a speck
of light.  So there three more rays are cast about each one that came through, so far apart that no
edge of two triangles takes more than one of them, and two of them have to come through too.
"""

from math import cos, pi, sin

import numpy as np
import numpy.typing as npt

from .hemisphere import frames
from .rays import Occlusion, as_visible

Array = npt.NDArray[np.float32]

NEARLY_DARK = 1 / 32  # of the rays reach the sky
ASIDE = 5e-4  # radians: wider than a slit that rounding makes looks from afar
BESIDE = 2.0**-21  # of an origin's largest coordinate, 4 steps of float32: and than it is nearby
CASTS = 3  # to confirm a ray, evenly about it:
AROUND = np.array([(cos(k * 2 * pi / CASTS), sin(k * 2 * pi / CASTS)) for k in range(CASTS)], "f4")


def doubtful(visible: Array, occlusion: Occlusion) -> npt.NDArray[np.bool_]:
    """Which points, of ``visible`` (P, N), 1 or 0, see so little that one ray too many would
    show; none where none can slip."""
    if not occlusion.lets_slip:
        return np.zeros(len(visible), bool)
    count = visible.shape[1]
    return np.asarray(visible @ np.ones(count, np.float32) <= NEARLY_DARK * count)


def confirmed(occlusion: Occlusion, origins: Array, directions: Array) -> Array:
    """Which of the clear rays (R, 3), of unit length, have clear ones about them, 1 or 0: CASTS
    rays each."""
    if not len(directions):
        return np.zeros(0, np.float32)
    across = frames(directions, np.zeros(len(directions))).matrices()
    sideways = [across[:, :, 0] * c + across[:, :, 1] * s for c, s in AROUND]
    beside = BESIDE * np.abs(origins).max(axis=1, keepdims=True)
    starts = np.concatenate([origins + beside * aside for aside in sideways])
    towards = np.concatenate([directions + ASIDE * aside for aside in sideways])
    clear = as_visible(occlusion.sky_mask(starts, towards)).reshape(CASTS, -1).sum(axis=0)
    return (2 * clear > CASTS).astype(np.float32)
