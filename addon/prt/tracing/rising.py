"""How steeply things rise, sector by sector, as seen from many places.

Places are gathered in boxes, and these in larger ones.  A thing is looked at from all places of a
box at once where looking from each of them would hardly tell more: where it is far away or low.
"""

from dataclasses import dataclass
from math import pi

import numpy as np
import numpy.typing as npt

Float = npt.NDArray[np.float64]
Index = npt.NDArray[np.int64]

SECTORS = 32  # about the normal, a power of two
BRANCHES = 4  # boxes that are one box
FAR = 6  # times as far away as a box reaches: then one look is enough
LOW = 0.01  # of the sky, about, that looking from a whole box may hide
MARGIN = 1e-3  # radians: more than rounding turns a direction by


@dataclass(frozen=True)
class Things:
    """C upright cylinders: their ``middle`` (2, C) across the third axis, their ``radius`` and
    upper ends, ``top`` (C,)."""

    middle: Float
    radius: Float
    top: Float


@dataclass(frozen=True)
class Boxes:
    """Boxes about places: their ``low`` ends along the third axis (B,); across it they lie within
    ``reach`` (B,) of the ``middle`` (2, B)."""

    low: Float
    middle: Float
    reach: Float

    @classmethod
    def between(cls, low: Float, high: Float) -> "Boxes":
        """From ``low`` to ``high`` (3, B)."""
        across = high[:2] - low[:2]
        return cls(low[2], 0.5 * (low + high)[:2], 0.5 * np.hypot(across[0], across[1]))


def nested(low: Float, high: Float) -> list[Boxes]:
    """Boxes from ``low`` to ``high`` (3, B), those about BRANCHES of them, and so on up to a
    few."""
    levels = [Boxes.between(low, high)]
    while low.shape[1] > BRANCHES:
        starts = np.arange(0, low.shape[1], BRANCHES)
        low, high = np.minimum.reduceat(low, starts, 1), np.maximum.reduceat(high, starts, 1)
        levels.append(Boxes.between(low, high))
    return levels


def steepest(levels: list[Boxes], things: Things) -> Float:
    """The largest tangent (B, SECTORS) of the elevation at which any of the ``things`` rises over
    the lower end of each of the first of the ``levels``, in each sector from the first axis to the
    second; infinite where one may stand overhead."""
    found = np.zeros((len(levels[-1].low), SECTORS))
    rising = np.flatnonzero(things.top > levels[0].low.min(initial=np.inf))
    box, thing = np.repeat(np.arange(len(found)), len(rising)), np.tile(rising, len(found))
    for depth in reversed(range(len(levels))):
        boxes = levels[depth]
        height = things.top.take(thing) - boxes.low.take(box)
        rises = np.flatnonzero(height > 0)
        box, thing, height = box.take(rises), thing.take(rises), height.take(rises)
        x, y = things.middle.take(thing, 1) - boxes.middle.take(box, 1)
        sideways, reach = np.sqrt(x * x + y * y), boxes.reach.take(box)
        spread = things.radius.take(thing) + reach
        gap = sideways - spread
        one_look = gap > 0
        if depth:
            sky = height**2 / (height**2 + gap**2)  # the cosine-weighted share that lies below
            one_look &= (gap > FAR * reach) | (sky * reach < LOW * gap)
        seen, left = np.flatnonzero(one_look), np.flatnonzero(~one_look)
        half = np.arcsin(spread.take(seen) / sideways.take(seen)) + MARGIN
        tangent = height.take(seen) / gap.take(seen)
        _raise(found, box.take(seen), np.arctan2(y.take(seen), x.take(seen)), half, tangent)
        box, thing = box.take(left), thing.take(left)
        if depth:
            count = len(levels[depth - 1].low)
            found = np.repeat(found, BRANCHES, axis=0)[:count]
            box = (BRANCHES * box[:, None] + np.arange(BRANCHES)).reshape(-1)
            thing = np.repeat(thing, BRANCHES)[box < count]
            box = box[box < count]
    found[box] = np.inf
    return found


def _raise(found: Float, box: Index, middle: Float, half: Float, tangent: Float) -> None:
    """Raise the sectors of ``found`` (B, SECTORS) that lie within ``half`` of ``middle`` (P,)
    radians to ``tangent`` (P,) at least, in the rows ``box`` (P,)."""
    to_sectors = SECTORS / (2 * pi)
    sector = np.floor((middle - half) * to_sectors).astype(np.int64)
    more = np.floor((middle + half) * to_sectors).astype(np.int64) - sector
    row, more = box * SECTORS, np.minimum(more, SECTORS - 1)
    while len(row):
        np.maximum.at(found.reshape(-1), row + (sector & SECTORS - 1), tangent)
        left = np.flatnonzero(more > 0)
        row, tangent = row.take(left), tangent.take(left)
        sector, more = sector.take(left) + 1, more.take(left) - 1
