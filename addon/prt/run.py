"""A run of the engine, from a job to its results, as a generator of progress."""

import platform
import sys
import time
from collections.abc import Generator, Iterator
from dataclasses import asdict, dataclass, field, replace
from importlib.metadata import PackageNotFoundError, version
from typing import Any

import numpy as np

from . import VERSION, light
from .job import Job, Progress, Receiver, ReceiverResult, Results, content_hash
from .points import Points, distinct_points
from .rays import Occlusion, occlusion
from .transfer import estimate_error, trace_all
from .verify import Measured, measure


@dataclass
class _Clock:
    """Seconds since the start, and by phase."""

    start: float = field(default_factory=time.perf_counter)
    phases: dict[str, float] = field(default_factory=dict)

    def lap(self, phase: str, since: float) -> None:
        self.phases[phase] = self.phases.get(phase, 0.0) + time.perf_counter() - since

    @property
    def now(self) -> float:
        return time.perf_counter() - self.start


@dataclass
class _Work:
    """Rays of the whole run, known and cast, for the progress bar."""

    total: int
    before: int = 0
    cast: int = 0

    def progress(self, phase: str, clock: _Clock) -> Progress:
        rays = self.before + self.cast
        return Progress(phase, min(1.0, rays / max(1, self.total)), rays, clock.now)

    def follow(self, phase: str, steps: Iterator[int], clock: _Clock) -> Iterator[Progress]:
        for self.cast in steps:
            yield self.progress(phase, clock)
        self.before += self.cast
        self.cast = 0


def run(job: Job) -> Generator[Progress, None, Results]:
    """Do ``job``; its results are the generator's value.  ``close()`` cancels it."""
    clock = _Clock()
    report: dict[str, Any] = {"job_hash": content_hash(job), "objects": []}
    image_sh = None
    yield Progress("light", 0.0)
    if job.light is not None:
        projected = light.project(job.light)
        image_sh = projected.image_sh
        report["light"] = _light_report(projected)
        clock.lap("light", clock.start)
    receivers: list[ReceiverResult] = []
    if job.kind != "light":
        yield from _transfer(job, clock, receivers, report)
    report.update(_run_report(job, clock))
    return Results(image_sh, tuple(receivers), report)


def _transfer(
    job: Job, clock: _Clock, receivers: list[ReceiverResult], report: dict[str, Any]
) -> Iterator[Progress]:
    """Bake or verify every receiver of ``job`` into ``receivers`` and ``report``."""
    yield Progress("points", 0.0, 0, clock.now)
    since = time.perf_counter()
    points = [distinct_points(receiver) for receiver in job.receivers]
    clock.lap("points", since)
    since = time.perf_counter()
    sky = occlusion(job.occluder_vertices, job.occluder_triangles)
    clock.lap("build", since)
    work = _Work(_rays_expected(job, points))
    for receiver, its_points in zip(job.receivers, points, strict=True):
        entry: dict[str, Any] = {"name": receiver.name}
        if job.kind == "bake":
            result = yield from _bake(job, receiver, its_points, sky, work, clock, entry)
            receivers.append(result)
            receiver = replace(receiver, transfer=result.element_transfer())
        if job.settings.verify_points:
            yield from _verify(job, receiver, its_points, sky, work, clock, entry)
        report["objects"].append(entry)


def _bake(
    job: Job,
    receiver: Receiver,
    points: Points,
    sky: Occlusion,
    work: _Work,
    clock: _Clock,
    entry: dict[str, Any],
) -> Generator[Progress, None, ReceiverResult]:
    settings, count = job.settings, len(points.origins)
    transfer = np.zeros((count, settings.order**2), np.float32)
    since = time.perf_counter()
    steps = trace_all(
        points, sky, settings.order, settings.rays, transfer, settings.seed, settings.threads
    )
    yield from work.follow("transfer", steps, clock)
    seconds = time.perf_counter() - since
    clock.lap("transfer", since)
    since = time.perf_counter()
    error, pilot = estimate_error(
        points, sky, settings.order, settings.rays, transfer, settings.seed
    )
    clock.lap("estimate", since)
    rays = count * settings.rays
    entry.update(
        points=count,
        elements=len(points.element_points),
        rays=rays + pilot,
        skipped={"the same position and normal": _repeated(points) * settings.rays},
        seconds={"transfer": seconds, "estimate": time.perf_counter() - since},
        mrays_per_second=rays / seconds / 1e6 if seconds > 0 else 0.0,
        estimated_error=error,
        measured_error=None,
    )
    return ReceiverResult(receiver.name, transfer[:, None], points.element_points)


def _verify(
    job: Job,
    receiver: Receiver,
    points: Points,
    sky: Occlusion,
    work: _Work,
    clock: _Clock,
    entry: dict[str, Any],
) -> Iterator[Progress]:
    settings = job.settings
    found: list[Measured] = []
    since = time.perf_counter()
    steps = measure(
        receiver,
        points,
        sky,
        settings.order,
        settings.verify_points,
        settings.verify_rays,
        settings.seed,
        found,
    )
    yield from work.follow("verify", steps, clock)
    clock.lap("verify", since)
    entry["measured_error"] = asdict(found[0])


def _rays_expected(job: Job, points: list[Points]) -> int:
    """Rays that the run will cast, but for the error estimate's few."""
    settings = job.settings
    baked = sum(len(p.origins) for p in points) * settings.rays if job.kind == "bake" else 0
    return baked + 2 * settings.verify_points * settings.verify_rays * len(points)


def _repeated(points: Points) -> int:
    """Elements that show a point which another one already shows."""
    return int((points.element_points >= 0).sum()) - len(points.origins)


def _light_report(projected: light.Projected) -> dict[str, Any]:
    size = {"width": projected.width, "height": projected.height}
    return {**size, "repaired": projected.repairs}


def _run_report(job: Job, clock: _Clock) -> dict[str, Any]:
    return {
        "versions": versions(),
        "settings": asdict(job.settings),
        "occluder_triangles": len(job.occluder_triangles),
        "repaired": job.repairs,
        "seconds": clock.phases,
        "peak_memory_bytes": peak_memory(),
        "wall_seconds": clock.now,
    }


def versions() -> dict[str, str]:
    """What the result was made with."""
    found = {"prt_baker": VERSION, "python": platform.python_version()}
    for package in ("numpy", "embreex", "OpenEXR"):
        try:
            found[package] = version(package)
        except PackageNotFoundError:
            continue
    return found


def peak_memory() -> int | None:
    """The largest resident size of this process so far in bytes; None on Windows."""
    if sys.platform == "win32":
        return None
    import resource

    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return int(peak if sys.platform == "darwin" else peak * 1024)
