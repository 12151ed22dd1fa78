"""The directions that no occluder can block, known without a ray.

Seen from a block of neighbouring points nothing rises above some elevation over their tangent
planes, and a direction above that reaches the sky.  The set of directions is ordered by its angle
to the normal, so those are its first ones, and only the rest is traced.  Where the points of a
block share their tangent frame, as on a floor or a wall, each sector about the normal has an
elevation of its own: things that stand around leave the view between them open.

Every bound is conservative.
"""

from math import pi

import numpy as np
import numpy.typing as npt

from .clusters import Clusters, Float
from .hemisphere import frames
from .rising import SECTORS, Things, nested, steepest

OVERHEAD = 1e9  # the tangent of an elevation that leaves nothing open
SAME = 1e-4  # difference of two frames that are one
FRAMES = 8  # of blocks that are looked at together
MIXED = 0.3  # radians between the normals of a block: its points are then looked at one by one


class Horizon:
    """How high the occluders, in ``clusters``, rise above the tangent planes of blocks of points:
    those whose frames are one, and, where it ``looks_at_curved`` ones, all."""

    def __init__(self, clusters: Clusters, looks_at_curved: bool = True) -> None:
        self._clusters, self._looks_at_curved = clusters, looks_at_curved

    def open_shares(self, origins: npt.ArrayLike, normals: npt.ArrayLike, parts: int = 1) -> Float:
        """For blocks of points (B, K, 3) with unit normals, in so many ``parts`` of neighbours
        each: sin² of the angle (B, parts, SECTORS) to the normal within which every direction of
        every point of the part reaches the sky.

        Sectors are counted from the tangent of ``hemisphere.frames``.  Their mean is the share of a
        cosine-distributed set that needs no ray.
        """
        places, its_normals = np.asarray(origins, np.float64), np.asarray(normals)
        if len(places) and (its_normals == its_normals[0, 0]).all():
            each = places.reshape(-1, places.shape[1] // parts, 3)
            frame = _frames(its_normals[0, :1].astype(np.float64))[0]
            return self._sector_shares(each, frame, 0.0).reshape(-1, parts, SECTORS)
        its_normals = its_normals.astype(np.float64)
        its_normals /= np.linalg.norm(its_normals, axis=2, keepdims=True)
        axis = its_normals.sum(axis=1)
        axis /= np.maximum(np.linalg.norm(axis, axis=1, keepdims=True), 1e-30)
        nearest = np.einsum("bkc,bc->bk", its_normals, axis).min(axis=1)
        tilt = np.arccos(np.clip(nearest, -1, 1))
        shares = np.empty((len(places), parts, SECTORS))
        frame = _common_frames(its_normals)
        which, first = _alike(frame)
        for k, row in enumerate(first):
            mine = which == k
            each = places[mine].reshape(-1, places.shape[1] // parts, 3)
            found = self._sector_shares(each, frame[row], float(tilt[mine].max()))
            shares[mine] = found.reshape(-1, parts, SECTORS)
        shares[which < 0] = 0
        others = (which < 0) & (self._looks_at_curved | ~np.isnan(frame[:, 0, 0]))
        mixed = others & (tilt > MIXED)
        others &= ~mixed
        elevation = self._elevation(places[others], axis[others], tilt[others])
        shares[others] = _open(elevation)[:, None, None]
        each, its_own = (v[mixed].reshape(-1, 3) for v in (places, its_normals))
        elevation = self._elevation(each[:, None], its_own, np.zeros(len(each)))
        shares[mixed] = _open(elevation).reshape(-1, parts, 1, places.shape[1] // parts).min(3)
        return shares

    def _sector_shares(self, places: Float, frame: Float, tilt: float) -> Float:
        """``open_shares`` (B, SECTORS) of neighbouring points (B, K, 3), whose normals are within
        ``tilt`` of the last row of ``frame`` (3, 3): their tangent, bitangent and normal."""
        c = self._clusters
        centres, turn = frame @ c.centres.T, c.axes @ frame[2]
        top = centres[2] + np.maximum(c.high * turn, c.low * turn)
        top += c.across * np.sqrt(np.maximum(1 - turn**2, 0))
        local = (places.reshape(-1, 3) @ frame.T).reshape(places.shape)
        local = np.ascontiguousarray(local.transpose(1, 2, 0))
        blocks = nested(local.min(axis=0), local.max(axis=0))
        tangent = np.minimum(steepest(blocks, Things(centres[:2], c.radius, top)), OVERHEAD)
        # the cosine of elevation and tilt together, but for the root of what divides its square
        cosine = np.cos(tilt) - np.sin(tilt) * tangent
        shares = np.square(np.maximum(cosine, 0)) / (1 + tangent * tangent)
        its = blocks[0]
        farthest = float(np.ptp(np.append(centres[:2], its.middle, axis=1), axis=1).max())
        slack = 2 * tilt * (2 * farthest + c.radius.max(initial=0) + its.reach.max(initial=0))
        shares[its.low - slack >= top.max(initial=-np.inf)] = 1
        return np.asarray(shares)

    def _elevation(self, places: Float, axis: Float, tilt: Float) -> Float:
        """The largest angle (B,) at which any cluster rises over the tangent planes of points
        (B, K, 3) whose normals are within ``tilt`` of ``axis`` (B, 3)."""
        c = self._clusters
        middle = 0.5 * (places.min(axis=1) + places.max(axis=1))
        offset = places - middle[:, None]
        along = np.einsum("bkc,bc->bk", offset, axis)
        squared = np.einsum("bkc,bkc->bk", offset, offset).max(axis=1)
        away = c.centres[:, None] - middle
        above = np.einsum("nbc,bc->nb", away, axis)
        distance = np.sqrt(np.einsum("nbc,nbc->nb", away, away))
        turn = c.axes @ axis.T
        reach = np.maximum(c.high[:, None] * turn, c.low[:, None] * turn)
        reach += c.across[:, None] * np.sqrt(np.maximum(1 - turn**2, 0))
        height = above + reach - along.min(axis=1)
        spread = c.radius[:, None] + np.sqrt(squared)
        gap = np.sqrt(np.maximum(distance**2 - above**2, 0)) - spread
        steep = np.where(gap > 0, height / np.where(gap > 0, gap, 1), np.inf)
        tangent = np.where(height > 0, steep, 0).max(axis=0, initial=0)
        rises = height + 2 * np.sin(0.5 * tilt) * (distance + spread) > 0
        return np.asarray(np.where(rises.any(axis=0), np.arctan(tangent) + tilt, 0))


def _open(elevation: Float) -> Float:
    """sin² of the angle to the normal that is left above an ``elevation``."""
    return np.asarray(np.cos(np.minimum(elevation, 0.5 * pi)) ** 2)


def _common_frames(normals: Float) -> Float:
    """Tangent, bitangent and normal (B, 3, 3), in rows, of blocks of unit ``normals`` (B, K, 3), as
    ``hemisphere`` turns its directions; NaN where the points of a block have none in common."""
    common = _frames(normals[:, 0])
    varied = np.flatnonzero((normals != normals[:, :1]).any(axis=(1, 2)))
    its = normals[varied]
    each = _frames(its.reshape(-1, 3)).reshape(*its.shape[:2], 3, 3)
    apart = (np.abs(each - each[:, :1]) > SAME).any(axis=(1, 2, 3))
    common[varied[apart]] = np.nan
    return common


def _frames(normals: Float) -> Float:
    """Tangents, bitangents and ``normals`` (N, 3), in rows (N, 3, 3) of unit length: a cosine that
    rounding takes from 1 makes an angle of its root."""
    rows = frames(normals, np.zeros(len(normals))).matrices().transpose(0, 2, 1).astype(np.float64)
    return np.asarray(rows / np.linalg.norm(rows, axis=2, keepdims=True))


def _alike(frame: Float) -> tuple[npt.NDArray[np.int64], list[int]]:
    """For each of the frames (B, 3, 3) which of the first few different ones it is, -1 for none of
    them; and those."""
    which, first = np.full(len(frame), -1), list[int]()
    left = ~np.isnan(frame[:, 0, 0])
    while left.any() and len(first) < FRAMES:
        k = int(np.argmax(left))
        mine = left & (np.abs(frame - frame[k]) <= SAME).all(axis=(1, 2))
        which[mine] = len(first)
        first.append(k)
        left &= ~mine
    return which, first
