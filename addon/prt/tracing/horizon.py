"""The directions that no occluder can block, known without a ray.

Seen from a block of neighbouring points nothing rises above some elevation over their tangent
planes, and a direction above that reaches the sky.  The set of directions is ordered by its angle
to the normal, so those are its first ones, and only the rest is traced.  Where the points of a
block share their tangent frame, as on a floor or a wall, each sector about the normal has an
elevation of its own: things that stand around leave the view between them open.

Every bound is conservative.
"""

from dataclasses import dataclass
from math import pi

import numpy as np
import numpy.typing as npt

from .clusters import Clusters, Float
from .hemisphere import frames

SECTORS = 32  # about the normal, a power of two
BRANCHES = 4  # groups of points that are one group
FAR = 6  # times as far away as points are apart: then these are looked at together
MARGIN = 1e-3  # radians: more than rounding turns a direction by
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
        places, its_normals = np.asarray(origins, np.float64), np.asarray(normals, np.float64)
        its_normals = its_normals / np.linalg.norm(its_normals, axis=2, keepdims=True)
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
            angles = self._sector_angles(each, frame[row], float(tilt[mine].max()))
            shares[mine] = _open(angles).reshape(-1, parts, SECTORS)
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

    def _sector_angles(self, places: Float, frame: Float, tilt: float) -> Float:
        """The largest angle (B, SECTORS) at which any cluster rises in each sector of ``frame``
        (3, 3), the rows tangent, bitangent and normal of neighbouring points (B, K, 3), whose
        normals are within ``tilt`` of it.

        What is far from many neighbours together is as high for all of them.
        """
        c = self._clusters
        local = places @ frame.T
        levels = _levels(local.min(axis=1), local.max(axis=1))
        centres, turn = c.centres @ frame.T, c.axes @ frame[2]
        top = centres[:, 2] + np.maximum(c.high * turn, c.low * turn)
        top += c.across * np.sqrt(np.maximum(1 - turn**2, 0))
        low = levels[0].low
        far = float(np.ptp(np.concatenate([centres[:, :2], low[:, :2]]), axis=0).max(initial=0))
        slack = 2 * tilt * (2 * far + c.radius.max(initial=0) + levels[0].reach.max(initial=0))
        above = np.flatnonzero(top > low[:, 2].min(initial=np.inf) - slack)
        found = np.zeros((len(levels[-1].low), SECTORS))
        block = np.repeat(np.arange(len(found)), len(above))
        cluster = np.tile(above, len(found))
        for depth in reversed(range(len(levels))):
            level = levels[depth]
            height = top[cluster] - level.low[block, 2]
            block, cluster, height = (v[height > 0] for v in (block, cluster, height))
            x, y = (centres[cluster, :2] - level.middle[block]).T
            sideways, reach = np.sqrt(x * x + y * y), level.reach[block]
            spread = c.radius[cluster] + reach
            gap = sideways - spread
            apart = gap > (FAR * reach if depth else 0)
            half = np.arcsin(spread[apart] / sideways[apart]) + MARGIN
            middle = np.arctan2(y[apart], x[apart])
            _raise(found, block[apart], middle, half, height[apart] / gap[apart])
            block, cluster = block[~apart], cluster[~apart]
            if depth:
                count = len(levels[depth - 1].low)
                found = np.repeat(found, BRANCHES, axis=0)[:count]
                block = (BRANCHES * block[:, None] + np.arange(BRANCHES)).reshape(-1)
                cluster = np.repeat(cluster, BRANCHES)[block < count]
                block = block[block < count]
        found[block] = np.inf
        rises = top.max(initial=-np.inf) > low[:, 2] - slack
        return np.asarray(np.where(rises[:, None], np.arctan(found) + tilt, 0))

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


@dataclass(frozen=True)
class _Level:
    """Boxes about groups of points: the ``low`` corner (B, 3), and across the third axis the
    ``middle`` (B, 2) and the ``reach`` (B,) from there."""

    low: Float
    middle: Float
    reach: Float


def _levels(low: Float, high: Float) -> list[_Level]:
    """Of the boxes from ``low`` to ``high`` (B, 3), and of BRANCHES of them together, and of as
    many of these, up to a few."""
    levels = list[_Level]()
    while True:
        middle, size = 0.5 * (low + high)[:, :2], (high - low)[:, :2]
        levels.append(_Level(low, middle, 0.5 * np.hypot(*size.T)))
        if len(low) <= BRANCHES:
            return levels
        starts = np.arange(0, len(low), BRANCHES)
        low, high = np.minimum.reduceat(low, starts), np.maximum.reduceat(high, starts)


def _open(elevation: Float) -> Float:
    """sin² of the angle to the normal that is left above an ``elevation``."""
    return np.asarray(np.cos(np.minimum(elevation, 0.5 * pi)) ** 2)


def _common_frames(normals: Float) -> Float:
    """Tangent, bitangent and normal (B, 3, 3), in rows, of blocks of unit ``normals`` (B, K, 3), as
    ``hemisphere`` turns its directions; NaN where the points of a block have none in common."""
    flat = normals.reshape(-1, 3)
    each = frames(flat, np.zeros(len(flat))).matrices().transpose(0, 2, 1).astype(np.float64)
    each = each.reshape(*normals.shape[:2], 3, 3)
    common = each[:, 0].copy()
    common[(np.abs(each - each[:, :1]) > SAME).any(axis=(1, 2, 3))] = np.nan
    return common


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


def _raise(
    found: Float, block: npt.NDArray[np.int64], middle: Float, half: Float, steep: Float
) -> None:
    """Raise the sectors of ``found`` (B, SECTORS) that lie within ``half`` of ``middle`` (P,)
    radians to ``steep`` (P,) at least, in the rows ``block`` (P,)."""
    to_sectors = SECTORS / (2 * pi)
    first = np.floor((middle - half) * to_sectors).astype(np.int64)
    last = np.floor((middle + half) * to_sectors).astype(np.int64)
    count = np.minimum(last - first + 1, SECTORS)
    place = np.arange(count.sum()) - np.repeat(np.cumsum(count) - count, count)
    sector = (np.repeat(first, count) + place) % SECTORS
    rows = np.repeat(block, count)
    np.maximum.at(found.reshape(-1), rows * SECTORS + sector, np.repeat(steep, count))
