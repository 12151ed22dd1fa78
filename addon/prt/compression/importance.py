"""What stored floats are worth: how the light weighs them, and what an error of each costs."""

import re
from collections.abc import Sequence
from math import pi, sqrt

import numpy as np
import numpy.typing as npt

from .. import sh

Float = npt.NDArray[np.float64]

SPARE = 0.05  # of the light's mean: what every coefficient of another light may well have
SLOT = re.compile(r"([TRSV])(\d+)([rgb]?)")


def radiance_of(slots: Sequence[str], baked_sh: Float, cut_out: Float, lights: Float) -> Float:
    """The exit radiance (F, 3) of a white surface that each float adds under the baked light
    ``baked_sh`` (25, 3), of which the cut-out ``lights``, irradiance over pi (lights, 3), have the
    coefficients ``cut_out`` (25, 3)."""
    result = np.zeros((len(slots), 3))
    lights_here = sum(name[:1] == "S" for name in slots)
    soft = baked_sh - cut_out if lights_here else baked_sh
    for place, (kind, index, channels) in enumerate(map(_parsed, slots)):
        if kind == "T":
            result[place, channels] = soft[index, channels]
        elif kind == "R" and index == 0:
            result[place, channels] = 1
        elif kind == "S" and index < len(lights):
            result[place] = lights[index]
    return result


def importance_of(slots: Sequence[str], baked_sh: Float, lights: Float) -> Float:
    """What an error of each float (F,) costs: the RMS over channels of the radiance that an error
    of 1 makes, over all turns of the baked light ``baked_sh`` (25, 3); with a little more, since
    another light has its energy elsewhere."""
    bands = sh.bands(sh.order_of(len(baked_sh)))
    power = np.zeros_like(baked_sh)
    np.add.at(power, bands, np.square(baked_sh))  # rows 0 .. 4: of each band
    mean = float(np.abs(baked_sh[0]).max()) or 1.0
    each = np.sqrt(power[bands] / (2 * bands[:, None] + 1) + (SPARE * mean) ** 2)
    result = np.zeros(len(slots))
    for place, (kind, index, channels) in enumerate(map(_parsed, slots)):
        if kind == "T":
            result[place] = np.linalg.norm(each[index, channels])
        elif kind == "R":
            result[place] = 1
        elif kind == "S":
            result[place] = np.linalg.norm(lights[index]) if index < len(lights) else mean
        elif kind == "V":
            result[place] = mean / (4 * pi) * sqrt(3)
    return result / sqrt(3)


def _parsed(slot: str) -> tuple[str, int, list[int]]:
    """Kind, number and colour channels of a float; no kind where it is unused."""
    found = SLOT.fullmatch(slot)
    if found is None:
        return "", 0, []
    channels = ["rgb".index(found[3])] if found[3] else [0, 1, 2]
    return found[1], int(found[2]), channels
