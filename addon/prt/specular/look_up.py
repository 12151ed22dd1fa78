"""About which direction, and in which level, filtered radiance comes nearest to what a surface
reflects.

A level is filtered with a round lobe, ``brdf.lobe``; the surface's own leans towards the normal,
and towards grazing it is narrow across the plane of view.  So radiance is read about
``mix(R, N, s)`` in the level of roughness ``q r``, s and q being those of the round lobe p that
makes

    integral (f - p) C (f - p),   C = -log sin² of half the angle between two directions,

smallest, f being the surface's own lobe.  That is the mean square of the error of the radiance
under light whose power falls with frequency as 1 / (l (l + 1)), as that of pictures of the world
does (Dror, Willsky and Adelson, Statistical characterization of real-world illumination, 2004).
``look_up.npy`` beside this module holds s and q as ``compute`` makes them.
"""

from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import numpy as np
import numpy.typing as npt

from ..parallel import workers
from . import table

Float = npt.NDArray[np.float64]

SIZE = 33  # nodes along each side of the file's grid
FILE = Path(__file__).with_name("look_up.npy")
GAUSS = 48  # see ``table.Lobe``
STEPS = 600  # at which a potential is found
ROUGHEST = 2.0**0.25  # of the levels: the widest lobes are wider than a cosine
NEAR_ONE = 1e-3  # the square of alpha stays so far from 1, where there is no formula
MOST_BENT = 3.0  # s is at most so many r²
RATIOS = (0.6, 1.25)  # between which q is
LOWEST = 1e-4  # cosine to the viewer
ROUNDS, TRIED, NARROWER = 5, 9, 0.3  # of the search: each round is over so much of the last


@dataclass(frozen=True)
class Potential:
    """C applied to a lobe that was filtered with, as a function of x = sin² of half the angle to
    its middle, and its own ``energy``, C applied twice.  The lobe ends at x = 1/2; from there on C
    sees it as a point, but for an ``offset`` by which every potential has the same mean."""

    squared: float
    steps: Float
    values: Float
    energy: float
    offset: float

    @classmethod
    def of(cls, roughness: float) -> "Potential":
        """By Gauss's law: the slope follows from how much of the lobe lies nearer to its middle."""
        squared = roughness**4
        if abs(1 - squared) < NEAR_ONE:
            squared = 1 - NEAR_ONE
        rest = 1 - squared
        steps = np.linspace(0, np.log1p(0.5 / squared), STEPS)
        x = squared * np.expm1(steps)
        x[-1] = 0.5
        low = squared + rest * x
        inside = (1 + 2 * squared / rest) * (1 / squared - 1 / low)
        inside -= 2 / rest * np.log(low / squared)
        inside /= inside[-1]
        slope = np.full(STEPS, inside[1] / x[1] - 1)
        slope[1:] = (inside[1:] - x[1:]) / (x[1:] * (1 - x[1:]))
        rises = _between(slope) * np.diff(x)
        values = np.append(np.cumsum(rises[::-1])[::-1], 0) + np.log(2)
        offset = 0.5 * np.log(2) + 0.5 - _between(values) @ np.diff(x)  # the mean of -log x is 1
        values += offset
        energy = float(_between(values) @ np.diff(inside))
        return cls(squared, steps, values, energy, float(offset))

    def __call__(self, x: Float) -> Float:
        """At ``x``, 0 to 1."""
        near = np.interp(np.log1p(np.minimum(x, 0.5) / self.squared), self.steps, self.values)
        return np.where(x < 0.5, near, self.offset - np.log(np.maximum(x, 0.5)))


def best(roughness: float, n_v: float) -> tuple[float, float]:
    """``s`` and ``q`` for a roughness above 0."""
    lobe = table.Lobe.of(roughness, n_v, GAUSS)
    weights = lobe.weights / lobe.weights.sum()
    s_v = float(np.sqrt(1 - n_v * n_v))
    ends = np.array([[0.0, min(1.0, MOST_BENT * roughness**2)], [*RATIOS]])
    ends[1] = np.minimum(ends[1], ROUGHEST / roughness)
    middle, half = ends.mean(axis=1), 0.5 * np.diff(ends, axis=1)[:, 0]
    for _ in range(ROUNDS):
        tried = np.linspace(middle - half, middle + half, TRIED, axis=1)
        shares, ratios = np.clip(tried, ends[:, :1], ends[:, 1:])
        axes = np.stack([-(1 - shares) * s_v, (1 - shares) * n_v + shares])
        axes /= np.hypot(*axes)
        x = np.clip(0.5 - 0.5 * (lobe.x_l[:, None] * axes[0] + lobe.n_l[:, None] * axes[1]), 0, 1)
        potentials = [Potential.of(ratio * roughness) for ratio in ratios]
        errors = np.array([found.energy - 2 * (weights @ found(x)) for found in potentials])
        ratio, share = np.unravel_index(errors.argmin(), errors.shape)
        middle, half = np.array([shares[share], ratios[ratio]]), half * NARROWER
    return float(middle[0]), float(middle[1])


def compute(size: int = SIZE) -> npt.NDArray[np.float32]:
    """Both (size, size, 2) at the nodes of a grid like ``table``'s.  At roughness 0, seen along the
    surface or from straight above, where any s is as good, they are those of nearby."""
    steps = np.linspace(0, 1, size)

    def row(roughness: float) -> list[tuple[float, float]]:
        rough = max(roughness, table.SMOOTHEST)
        return [best(rough, float(np.clip(step**2, LOWEST, 1 - LOWEST))) for step in steps]

    with workers(0) as pool:
        return np.array(list(pool.map(row, [float(step) for step in steps])), np.float32)


@lru_cache(maxsize=1)
def load() -> npt.NDArray[np.float32]:
    """Both (table.SIZE, table.SIZE, 2), from the nodes that are shipped."""
    places = np.linspace(0, 1, table.SIZE)
    roughness, root = (v.ravel() for v in np.meshgrid(places, places, indexing="ij"))
    values = table.bilinear(np.load(FILE), roughness, root**2).astype(np.float32)
    found = values.reshape(table.SIZE, table.SIZE, 2)
    found.flags.writeable = False
    return found


def at(roughness: npt.ArrayLike, n_v: npt.ArrayLike) -> tuple[Float, Float]:
    """Each (P,), as the nodes read them."""
    found = table.bilinear(load(), roughness, n_v)
    return found[:, 0], found[:, 1]


def _between(values: Float) -> Float:
    """The means of neighbours."""
    return 0.5 * (values[1:] + values[:-1])
