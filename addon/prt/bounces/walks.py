"""Random walks: what a bake with bounces is measured by.

Each ray of a place goes on from where it ends, in a direction drawn about the triangle's own
normal, until it reaches the sky or has bounced as often as is asked for; it is worth the product of
the albedos on its way.  Nothing is known here of points, entries or what was kept.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from .. import sh
from ..surface.points import surface_bias
from ..tracing.hemisphere import cosine_fibonacci, frames
from ..tracing.rays import Geometry, Mask, Vectors

Float = npt.NDArray[np.float64]

DARKEST = 1e-6  # a walk that is worth less ends


@dataclass(frozen=True)
class Walls:
    """What walks meet: ``geometry`` over ``triangles`` (F, 3) of ``vertices`` (V, 3), with the
    ``albedo`` (F, 3, 3) of their corners."""

    geometry: Geometry
    vertices: Vectors
    triangles: Mask
    albedo: Vectors

    def at(self, triangles: Mask, u: Vectors, v: Vectors) -> tuple[Float, Float, Float, Float]:
        """Places, unit geometric normals and albedos (R, 3) at ``u`` and ``v`` (R,) of
        ``triangles`` (R,), and how far (R, 1) off the surface rays start from."""
        corners = self.vertices[self.triangles[triangles]].astype(np.float64)
        shares = np.stack([1 - u - v, u, v], axis=1).astype(np.float64)
        cross = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        normals = cross / np.maximum(np.linalg.norm(cross, axis=1, keepdims=True), 1e-300)
        places = np.einsum("rk,rkc->rc", shares, corners)
        albedo = np.einsum("rk,rkc->rc", shares, self.albedo[triangles].astype(np.float64))
        return places, normals, albedo, surface_bias(corners)


def walk(  # noqa: PLR0917 - all of a walk
    origins: Float, normals: Float, walls: Walls, rays: int, bounces: int, order: int, seed: int
) -> Iterator[tuple[Float, int]]:
    """For each of the places ``origins`` (P, 3) about unit ``normals`` (P, 3) the transfer
    (3, n²) by ``rays`` walks, and the rays cast so far."""
    rng = np.random.default_rng([seed, 7])
    azimuth = rng.random(len(normals)) * 2 * np.pi
    local, cast = cosine_fibonacci(rays), 0
    for p, matrix in enumerate(frames(normals, azimuth).matrices()):
        directions = local @ matrix.T.astype(np.float64)
        starts = np.repeat(origins[p : p + 1], rays, axis=0)
        worth = np.full((rays, 3), 1 / rays)
        found = np.zeros((3, order**2))
        for bounce in range(bounces + 1):
            cast += len(starts)
            met = walls.geometry.first_met(starts.astype(np.float32), directions.astype(np.float32))
            sky = met.triangles < 0
            found += worth[sky].T @ sh.basis(directions[sky], order)
            if bounce == bounces or sky.all():
                break
            places, facing, albedo, off = walls.at(met.triangles[~sky], met.u[~sky], met.v[~sky])
            along = np.einsum("rc,rc->r", facing, directions[~sky])
            facing *= np.where(along > 0, -1.0, 1.0)[:, None]
            worth = worth[~sky] * albedo
            alive = worth.max(axis=1) * rays > DARKEST
            starts, worth = (places + off * facing)[alive], worth[alive]
            directions = _about(facing[alive], rng)
        yield found, cast


def _about(normals: Float, rng: np.random.Generator) -> Float:
    """A cosine-distributed direction about each of ``normals`` (R, 3)."""
    squared, angle = rng.random((2, len(normals)))
    radius, angle = np.sqrt(squared), angle * 2 * np.pi
    local = np.stack([radius * np.cos(angle), radius * np.sin(angle), np.sqrt(1 - squared)], 1)
    turns = frames(normals, np.zeros(len(normals))).matrices().astype(np.float64)
    return np.asarray(np.einsum("rij,rj->ri", turns, local))
