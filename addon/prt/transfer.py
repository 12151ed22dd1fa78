"""Shadowed transfer vectors: rays from points, summed against the basis.

T_i = 1/pi integral V(w) max(n.w, 0) Y_i(w) dw: dot with radiance coefficients gives the exit
radiance of a white surface, so 1/pi is inside and the surface's albedo is not.
"""

import os
import threading
from collections.abc import Generator
from concurrent.futures import FIRST_COMPLETED, Future, ThreadPoolExecutor, wait
from dataclasses import replace

import numpy as np
import numpy.typing as npt

from .hemisphere import Frames, SetInWorld, Turn, frames, hemisphere_set
from .job import Settings
from .points import Points
from .rays import Occlusion

Array = npt.NDArray[np.float32]

BATCH_RAYS = 32768
PILOT_POINTS = 1024
ERROR_OF_DIFFERENCE = 0.325  # of |T(N) - T(N/4)|, pooled: within 10 % of the true error of T(N)


class Tracer:
    """Fills transfer vectors for batches of points.  One product makes a batch's directions, one
    Embree call its visibility, one product its local coefficients."""

    def __init__(self, points: Points, occlusion: Occlusion, settings: Settings) -> None:
        self.points, self._occlusion, self.rays = points, occlusion, settings.rays
        random = np.random.default_rng([settings.seed, settings.rays])
        self._azimuth = random.random(len(points.origins)) * (2 * np.pi)
        directions = hemisphere_set(settings.rays, settings.order)
        self._in_world = SetInWorld(directions.directions)
        self._clear_weights = -directions.weights  # the mask's -1 is clear
        self._turn = Turn(settings.order)
        self._buffers = threading.local()

    def batches(self, size: int) -> list[slice]:
        """Slices of ``size`` points."""
        count = len(self.points.origins)
        return [slice(start, min(start + size, count)) for start in range(0, count, size)]

    def trace(self, part: slice, out: Array) -> None:
        """Transfer of the points of ``part`` into ``out`` (P, n²)."""
        count = part.stop - part.start
        origins, directions = self._buffer(count)
        local = self._frames(part)
        origins.reshape(count, self.rays, 3)[:] = self.points.origins[part, None]
        self._in_world(local.matrices(), directions)
        mask = self._occlusion.sky_mask(origins, directions).reshape(count, self.rays)
        out[part] = self._turn(local, mask.astype(np.float32) @ self._clear_weights)

    def _frames(self, part: slice) -> Frames:
        return frames(self.points.normals[part], self._azimuth[part])

    def _buffer(self, count: int) -> tuple[Array, Array]:
        """Two (count * rays, 3) arrays of this thread."""
        needed = count * self.rays
        if getattr(self._buffers, "size", 0) < needed:
            self._buffers.arrays = np.empty((2, needed, 3), np.float32)
            self._buffers.size = needed
        first, second = self._buffers.arrays[:, :needed]
        return first, second


def trace_all(
    points: Points, occlusion: Occlusion, settings: Settings, out: Array
) -> Generator[int, None, None]:
    """Fill ``out`` (P, n²) and yield the rays cast so far; ``close()`` stops it.

    The same bits for any number of threads: batches don't depend on it.
    """
    tracer = Tracer(points, occlusion, settings)
    parts = tracer.batches(max(1, BATCH_RAYS // settings.rays))
    cast = 0
    pool = ThreadPoolExecutor(settings.threads or available_cores())
    try:
        pending: set[Future[int]] = {pool.submit(_trace, tracer, part, out) for part in parts}
        while pending:
            done, pending = wait(pending, return_when=FIRST_COMPLETED)
            cast += sum(future.result() for future in done)
            yield cast
    finally:
        pool.shutdown(wait=True, cancel_futures=True)


def _trace(tracer: Tracer, part: slice, out: Array) -> int:
    tracer.trace(part, out)
    return int(part.stop - part.start) * tracer.rays


def available_cores() -> int:
    """The cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def estimate_error(
    points: Points, occlusion: Occlusion, settings: Settings, transfer: Array
) -> tuple[float, int]:
    """The relative RMS error of ``transfer`` (P, n²), and the rays that finding it took.

    A part of the points is traced again with a quarter of the rays and other azimuths; the pooled
    difference times a constant is the error of the full set.
    """
    few = replace(settings, rays=max(1, settings.rays // 4), seed=settings.seed + 1)
    chosen = np.unique(np.linspace(0, len(points.origins) - 1, PILOT_POINTS).astype(np.int64))
    pilot_points = Points(points.origins[chosen], points.normals[chosen], points.element_points[:0])
    pilot = np.empty((len(chosen), settings.order**2), np.float32)
    *_, cast = trace_all(pilot_points, occlusion, few, pilot)
    return ERROR_OF_DIFFERENCE * relative_rms(pilot, transfer[chosen]), cast


def relative_rms(values: npt.ArrayLike, reference: npt.ArrayLike) -> float:
    """RMS of the difference over the RMS of the reference; 0 where both are 0."""
    expected = np.asarray(reference, np.float64)
    difference = float(np.mean((np.asarray(values) - expected) ** 2))
    size = float(np.mean(expected**2))
    return (difference / size) ** 0.5 if size > 0 else float(difference > 0)
