"""Rays that slipped between two triangles, found where they would show.

Embree's fast mode lets about one ray in four million through the edges of a closed mesh.  Among the
clear rays of a point in the open that is nothing; at a point that sees next to no sky it is a speck
of light.  So there three more rays are cast about each one that came through, so far apart that no
edge of two triangles takes more than one of them, and two of them have to come through too.
"""

from math import pi

import numpy as np
import numpy.typing as npt

from .rays import Occlusion

Array = npt.NDArray[np.float32]

NEARLY_DARK = 1 / 32  # of the rays reach the sky
ASIDE = 5e-4  # radians: wider than a slit that rounding makes looks from afar
BESIDE = 2.0**-21  # of an origin's largest coordinate, 4 steps of float32: and than it is nearby
CASTS = 3  # to confirm a ray


def doubtful(visible: Array, occlusion: Occlusion) -> npt.NDArray[np.bool_]:
    """Which points, of ``visible`` (P, N), 1 or 0, see so little that one ray too many would
    show; none where none can slip."""
    if not occlusion.lets_slip:
        return np.zeros(len(visible), bool)
    return np.asarray(visible.sum(axis=1) <= NEARLY_DARK * visible.shape[1])


def confirmed(occlusion: Occlusion, origins: Array, directions: Array) -> Array:
    """Which of the clear rays (R, 3), of unit length, have clear ones about them, 1 or 0: CASTS
    rays each."""
    if not len(directions):
        return np.zeros(0, np.float32)
    axis = np.zeros_like(directions)
    axis[np.arange(len(axis)), np.abs(directions).argmin(axis=1)] = 1
    along = np.cross(directions, axis)
    along /= np.linalg.norm(along, axis=1, keepdims=True)
    across, steps = np.cross(directions, along), BESIDE * np.abs(origins).max(axis=1, keepdims=True)
    clear = np.zeros(len(directions), np.int32)
    for angle in np.arange(CASTS, dtype=np.float32) * np.float32(2 * pi / CASTS):
        sideways = np.cos(angle) * along + np.sin(angle) * across
        clear -= occlusion.sky_mask(origins + steps * sideways, directions + ASIDE * sideways)
    return (2 * clear > CASTS).astype(np.float32)
