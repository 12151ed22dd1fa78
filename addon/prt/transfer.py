"""Shadowed transfer vectors: rays from points, summed against the basis.

T_i = 1/pi integral V(w) max(n.w, 0) Y_i(w) dw: dot with radiance coefficients gives the exit
radiance of a white surface, so 1/pi is inside and the surface's albedo is not.
"""

import os
import threading
from collections.abc import Generator, Iterator
from concurrent.futures import FIRST_COMPLETED, Future, ThreadPoolExecutor, wait
from dataclasses import replace

import numpy as np
import numpy.typing as npt

from .hemisphere import RaysInWorld, Turn, frames, hemisphere_set
from .job import Settings
from .points import Points
from .rays import Occlusion

Array = npt.NDArray[np.float32]

BATCH_RAYS = 32768
BATCHES_PER_PART = 16
PILOT_POINTS = 1024
ERROR_OF_DIFFERENCE = 0.325  # of |T(N) - T(N/4)|, pooled: within 10 % of the true error of T(N)


class Tracer:
    """Fills transfer vectors of parts of the points.

    For a batch of points two products make the rays, one Embree call finds their visibility, and
    one product sums the local coefficients; a part of many batches is turned to world axes at once.
    """

    def __init__(self, points: Points, occlusion: Occlusion, settings: Settings) -> None:
        self.points, self._occlusion, self.rays = points, occlusion, settings.rays
        random = np.random.default_rng([settings.seed, settings.rays])
        self._azimuth = random.random(len(points.origins)) * (2 * np.pi)
        directions = hemisphere_set(settings.rays, settings.order)
        self._in_world = RaysInWorld(directions.directions)
        self._clear_weights = -directions.weights  # the mask's -1 is clear
        self._turn = Turn(settings.order)
        self._batch = max(1, BATCH_RAYS // settings.rays)
        self._buffers = threading.local()

    def parts(self) -> list[slice]:
        """Slices of the points, each of some batches."""
        size = self._batch * BATCHES_PER_PART
        return list(_slices(0, len(self.points.origins), size))

    def trace(self, part: slice, out: Array) -> None:
        """Transfer of the points of ``part`` into ``out`` (P, n²)."""
        local = frames(self.points.normals[part], self._azimuth[part])
        matrices = local.matrices()
        for batch in _slices(part.start, part.stop, self._batch):
            inside = slice(batch.start - part.start, batch.stop - part.start)
            out[batch] = self._trace_batch(self.points.origins[batch], matrices[inside])
        out[part] = self._turn(local, out[part])

    def _trace_batch(self, starts: Array, matrices: Array) -> Array:
        """Local coefficients (P, n²) of points at ``starts`` (P, 3) with frames (P, 3, 3)."""
        origins, directions = self._buffer(len(starts))
        self._in_world.origins(starts, origins)
        self._in_world.directions(matrices, directions)
        mask = self._occlusion.sky_mask(origins, directions).reshape(len(starts), self.rays)
        return mask.astype(np.float32) @ self._clear_weights

    def _buffer(self, count: int) -> tuple[Array, Array]:
        """Two (count * rays, 3) arrays of this thread."""
        if not hasattr(self._buffers, "arrays"):
            self._buffers.arrays = np.empty((2, self._batch * self.rays, 3), np.float32)
        origins, directions = self._buffers.arrays[:, : count * self.rays]
        return origins, directions


def _slices(start: int, stop: int, size: int) -> Iterator[slice]:
    return (slice(i, min(i + size, stop)) for i in range(start, stop, size))


def trace_all(
    points: Points, occlusion: Occlusion, settings: Settings, out: Array
) -> Generator[int, None, None]:
    """Fill ``out`` (P, n²) and yield the rays cast so far; ``close()`` stops it.

    The same bits for any number of threads: batches don't depend on it.
    """
    tracer = Tracer(points, occlusion, settings)
    cast = 0
    pool = ThreadPoolExecutor(settings.threads or available_cores())
    try:
        pending: set[Future[int]] = {
            pool.submit(_trace, tracer, part, out) for part in tracer.parts()
        }
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
