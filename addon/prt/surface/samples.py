"""Places inside the triangles of a surface, and where rays start from them."""

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from .points import Float, Index, Surface, face_normals, lift, morton_order, surface_bias

EDGE = 0.02  # of a triangle's height: no sample lies nearer to an edge
CANDIDATES = 64  # triangles for a place: enough for places as even as among all
PLASTIC = 1.32471795724474602596  # Roberts' R2 sequence: its powers spread pairs evenly


@dataclass(frozen=True)
class Places:
    """Places on a surface: their triangles (S,) and barycentric coordinates (S, 3)."""

    triangles: Index
    barycentric: Float

    def __len__(self) -> int:
        return len(self.triangles)

    def __getitem__(self, chosen: npt.NDArray[np.bool_] | Index | slice) -> "Places":
        return Places(self.triangles[chosen], self.barycentric[chosen])


def random_places(areas: Float, count: int, seed: int) -> Places:
    """``count`` places, uniform over triangles with ``areas`` (F,)."""
    rng = np.random.default_rng([seed, count])
    triangles = _drawn(areas, count, rng)
    u, v = rng.random((2, count))
    return Places(triangles, _barycentric(u, v))


def stratified_places(
    surface: Surface, chosen: Index, density: Float, count: int, seed: int
) -> Places:
    """``count`` places in the triangles ``chosen`` (C,), as many in each as its ``density`` (C,)
    says: one in each of ``count`` equal parts of it along a Z curve, and none near an edge."""
    rng = np.random.default_rng([seed, count])
    if CANDIDATES * count < len(chosen):  # a curve through all of them would not pay
        some = _drawn(density, CANDIDATES * count, rng)
        chosen, density = chosen[some], np.ones(len(some))
    along = morton_order(surface.corners_of(chosen).mean(axis=1))
    order, share = chosen[along], np.cumsum(density[along])
    i = np.arange(count)
    within = rng.random(count)
    found = np.searchsorted(share, (i + within) / count * share[-1], side="right")
    triangles = order[np.minimum(found, len(order) - 1)]
    spread = [(0.5 + i * PLASTIC**-power) % 1 for power in (1, 2)]
    return Places(triangles, EDGE + (1 - 3 * EDGE) * _barycentric(spread[0], spread[1]))


def _drawn(weights: Float, count: int, rng: np.random.Generator) -> Index:
    """``count`` of the rows of ``weights`` (N,), each as likely as its weight says."""
    share = np.cumsum(weights)
    return np.asarray(np.searchsorted(share, rng.random(count) * share[-1]))


def _barycentric(u: npt.NDArray[Any], v: npt.NDArray[Any]) -> Float:
    """Uniform places (S, 3) of a triangle from uniform ``u`` and ``v`` (S,)."""
    outside = u + v > 1
    u, v = np.where(outside, 1 - u, u), np.where(outside, 1 - v, v)
    return np.stack([1 - u - v, u, v], axis=1)


def starts(
    surface: Surface, rows: npt.NDArray[Any], normals: npt.NDArray[Any], places: Places
) -> tuple[Float, Float]:
    """Ray origins and unit shading normals (S, 3) at ``places``, where ``rows`` (F, 3) are those of
    ``normals`` (E, 3) at the triangles' corners: up to the tangent planes there, as Hanika does it,
    and off the surface."""
    barycentric = places.barycentric
    corners = surface.corners_of(places.triangles)
    corner_normals = normals[rows[places.triangles]].astype(np.float64)
    mean = np.einsum("pk,pkc->pc", barycentric, corner_normals)
    lengths = np.linalg.norm(mean, axis=1, keepdims=True)
    facing = face_normals(corners)
    inside = np.einsum("pk,pkc->pc", barycentric, corners)
    lifts = [lift(inside, corners[:, k], corner_normals[:, k]) for k in range(3)]
    lifted = inside + np.einsum("pk,kpc->pc", barycentric, np.array(lifts))
    sound = np.where(lengths > 1e-6, mean / np.maximum(lengths, 1e-6), facing)
    return lifted + surface_bias(corners) * facing, sound
