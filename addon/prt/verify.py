"""The measured error of a bake: some of it traced again by brute force.

The reference knows nothing of the baker's short cuts: each point sums the basis over its own world
directions, with a ray each, in float64 and without the correction.
"""

from collections.abc import Generator, Iterator
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from . import sh
from .buried import buried
from .hemisphere import cosine_fibonacci, frames
from .job import Receiver, Settings
from .points import Points, Surface, element_triangles, lift, surface_bias
from .rays import Occlusion
from .transfer import relative_rms

Float = npt.NDArray[np.float64]


@dataclass(frozen=True)
class Measured:
    """Relative RMS errors of the transfer: ``at_points``, where it was traced (the rays' noise),
    and ``on_surface``, between the vertices too (noise and the mesh's coarseness)."""

    at_points: float
    on_surface: float
    points: int
    rays: int


@dataclass(frozen=True)
class SurfacePoints:
    """Random points of a surface: ray origins (P, 3), shading normals (P, 3), and the transfer
    (P, channels, n²) that the mesh shows there."""

    origins: Float
    normals: Float
    shown: Float


def random_surface_points(receiver: Receiver, count: int, seed: int) -> SurfacePoints:
    """``count`` points, uniform over the area of ``receiver``, which has its transfer."""
    assert receiver.transfer is not None
    rng = np.random.default_rng([seed, count])
    surface = Surface.of(receiver)
    share = np.cumsum(surface.areas)
    triangle = np.searchsorted(share, rng.random(count) * share[-1])
    u, v = rng.random((2, count))
    outside = u + v > 1
    u, v = np.where(outside, 1 - u, u), np.where(outside, 1 - v, v)
    barycentric = np.stack([1 - u - v, u, v], axis=1)
    elements = element_triangles(receiver)[triangle]
    corners = surface.corners[triangle]
    corner_normals = receiver.normals[elements].astype(np.float64)
    normals = np.einsum("pk,pkc->pc", barycentric, corner_normals)
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    inside = np.einsum("pk,pkc->pc", barycentric, corners)
    lifts = [lift(inside, corners[:, k], corner_normals[:, k]) for k in range(3)]
    lifted = inside + np.einsum("pk,kpc->pc", barycentric, np.array(lifts))
    origins = lifted + surface_bias(corners) * surface.normals[triangle]
    shown = np.einsum("pk,pkci->pci", barycentric, receiver.transfer[elements].astype(np.float64))
    return SurfacePoints(origins, normals, shown)


def brute_force(
    origins: Float, normals: Float, occlusion: Occlusion, settings: Settings, out: Float
) -> Iterator[int]:
    """Fill ``out`` (P, n²) with the transfer at ``origins`` (P, 3) about unit ``normals`` (P, 3),
    by ``verify_rays`` rays each, and yield the rays cast so far."""
    rays = settings.verify_rays
    azimuth = np.random.default_rng([settings.seed, 7]).random(len(normals)) * 2 * np.pi
    local = cosine_fibonacci(rays)
    for p, matrix in enumerate(frames(normals, azimuth).matrices()):
        directions = local @ matrix.T.astype(np.float64)
        start = np.repeat(origins[p : p + 1].astype(np.float32), rays, axis=0)
        mask = occlusion.sky_mask(start, directions.astype(np.float32))
        out[p] = sh.basis(directions[mask != 0], settings.order).sum(axis=0) / rays
        yield (p + 1) * rays


def measure(
    receiver: Receiver,
    points: Points,
    occlusion: Occlusion,
    settings: Settings,
) -> Generator[int, None, Measured]:
    """Trace ``verify_points`` random points of the surface, and as many of the baked ones, again.

    Yields the rays cast so far; the errors are the generator's value.  Points inside of other
    things, which nobody sees, don't count.
    """
    assert receiver.transfer is not None
    count = settings.verify_points
    surface = random_surface_points(receiver, count, settings.seed)
    chosen = np.unique(np.linspace(0, len(points.origins) - 1, count).astype(np.int64))
    baked = _baked_at(receiver, points, chosen)
    origins = np.concatenate([surface.origins, points.origins[chosen]])
    normals = np.concatenate([surface.normals, points.normals[chosen]])
    reference = np.empty((len(origins), settings.order**2))
    yield from brute_force(origins, normals, occlusion, settings, reference)
    shown = np.concatenate([surface.shown, baked])
    expected = np.repeat(reference[:, None], shown.shape[1], axis=1)
    seen = ~buried(origins.astype(np.float32), normals.astype(np.float32), reference, occlusion)
    where = np.arange(len(origins)) < count
    on_surface = relative_rms(shown[seen & where], expected[seen & where])
    at_points = relative_rms(shown[seen & ~where], expected[seen & ~where])
    return Measured(at_points, on_surface, len(origins), len(origins) * settings.verify_rays)


def _baked_at(receiver: Receiver, points: Points, chosen: npt.NDArray[np.int64]) -> Float:
    """What the receiver's elements show at the ``chosen`` points."""
    assert receiver.transfer is not None
    element = np.zeros(len(points.origins), np.int64)
    seen = np.flatnonzero(points.element_points >= 0)
    element[points.element_points[seen]] = seen
    return np.asarray(receiver.transfer[element[chosen]], np.float64)
