"""A run of the engine, from a job to its results, as a generator of progress."""

import platform
import sys
import time
from collections.abc import Generator, Iterator
from contextlib import contextmanager
from dataclasses import asdict, dataclass, field, replace
from importlib.metadata import PackageNotFoundError, version
from typing import Any, TypeVar, cast

import numpy as np

from . import VERSION, light
from .buried import buried, fill
from .job import Job, Progress, Receiver, ReceiverResult, Results, Settings, content_hash
from .points import Points, distinct_points
from .rays import Occlusion, occlusion
from .transfer import estimate_error, trace_all
from .verify import measure

Value = TypeVar("Value")


Entry = dict[str, Any]


@dataclass
class _Meter:
    """Rays and seconds of a run: known, spent, and spent by phase."""

    start: float = field(default_factory=time.perf_counter)
    rays_expected: int = 0
    rays: int = 0
    seconds: dict[str, float] = field(default_factory=dict)

    @property
    def elapsed(self) -> float:
        return time.perf_counter() - self.start

    @contextmanager
    def phase(self, name: str) -> Iterator[None]:
        """Count the seconds inside as ``name``'s."""
        since = time.perf_counter()
        yield
        self.seconds[name] = self.seconds.get(name, 0.0) + time.perf_counter() - since

    def follow(
        self, phase: str, steps: Generator[int, None, Value]
    ) -> Generator[Progress, None, Value]:
        """Progress of ``steps``, which yield the rays that they have cast; their value."""
        before = self.rays
        while True:
            try:
                self.rays = before + next(steps)
            except StopIteration as stop:
                return cast(Value, stop.value)
            yield self.progress(phase)

    def progress(self, phase: str) -> Progress:
        fraction = min(1.0, self.rays / max(1, self.rays_expected))
        return Progress(phase, fraction, self.rays, self.elapsed)


def run(job: Job) -> Generator[Progress, None, Results]:
    """Do ``job``; its results are the generator's value.  ``close()`` cancels it."""
    meter = _Meter()
    report: dict[str, Any] = {"job_hash": content_hash(job), "objects": []}
    image_sh = None
    yield meter.progress("light")
    if job.light is not None:
        with meter.phase("light"):
            projected = light.project(job.light)
        image_sh = projected.image_sh
        report["light"] = _light_report(projected)
    receivers: tuple[ReceiverResult, ...] = ()
    if job.kind != "light":
        receivers = yield from _transfer(job, meter, report["objects"])
    report.update(_run_report(job, meter))
    return Results(image_sh, receivers, report)


def _transfer(
    job: Job, meter: _Meter, entries: list[Entry]
) -> Generator[Progress, None, tuple[ReceiverResult, ...]]:
    """Bake or verify every receiver of ``job``, with an entry of the report for each."""
    yield meter.progress("prepare")
    with meter.phase("prepare"):
        points = [distinct_points(receiver) for receiver in job.receivers]
        sky = occlusion(job.occluder_vertices, job.occluder_triangles)
    meter.rays_expected = _rays_expected(job, points)
    results: list[ReceiverResult] = []
    for receiver, its_points in zip(job.receivers, points, strict=True):
        entry: Entry = {"name": receiver.name}
        if job.kind == "bake":
            result = yield from _bake(
                receiver, its_points, sky, job.settings, meter=meter, entry=entry
            )
            results.append(result)
        if job.settings.verify_points:
            with meter.phase("verify"):
                shown = (
                    results[-1].at_elements(results[-1].transfer) if results else receiver.transfer
                )
                steps = measure(replace(receiver, transfer=shown), its_points, sky, job.settings)
                measured = yield from meter.follow("verify", steps)
            entry["measured_error"] = asdict(measured)
        entries.append(entry)
    return tuple(results)


def _bake(
    receiver: Receiver,
    points: Points,
    sky: Occlusion,
    settings: Settings,
    *,
    meter: _Meter,
    entry: Entry,
) -> Generator[Progress, None, ReceiverResult]:
    """Trace ``points`` and write down what it took."""
    count = len(points.origins)
    transfer = np.zeros((count, settings.order**2), np.float32)
    before = dict(meter.seconds)
    with meter.phase("transfer"):
        yield from meter.follow("transfer", trace_all(points, sky, settings, transfer))
    with meter.phase("estimate"):
        error, pilot_rays = estimate_error(points, sky, settings, transfer)
        hidden = buried(points.origins, points.normals, transfer, sky)
        fill(points, receiver, transfer, hidden)
    spent = {k: meter.seconds[k] - before.get(k, 0.0) for k in ("transfer", "estimate")}
    rays = count * settings.rays
    entry.update(
        points=count,
        elements=len(points.element_points),
        buried_points=int(hidden.sum()),
        rays=rays + pilot_rays,
        skipped={"the same position and normal": _repeated(points) * settings.rays},
        seconds=spent,
        mrays_per_second=rays / max(spent["transfer"], 1e-9) / 1e6,
        estimated_error=error,
        measured_error=None,
    )
    return ReceiverResult(receiver.name, transfer[:, None], points.element_points)


def _rays_expected(job: Job, points: list[Points]) -> int:
    """Rays that the run will cast, but for the error estimate's few."""
    settings = job.settings
    baked = sum(len(p.origins) for p in points) * settings.rays if job.kind == "bake" else 0
    return baked + 2 * settings.verify_points * settings.verify_rays * len(points)


def _repeated(points: Points) -> int:
    """Elements that show a point which another one already shows."""
    return int((points.element_points >= 0).sum()) - len(points.origins)


def _light_report(projected: light.Projected) -> dict[str, Any]:
    return {
        "projection": "cubemap" if projected.is_cubemap else "lat-long",
        "width": projected.width,
        "height": projected.height,
        "repaired": projected.repairs,
    }


def _run_report(job: Job, meter: _Meter) -> dict[str, Any]:
    return {
        "versions": versions(),
        "settings": asdict(job.settings),
        "occluder_triangles": len(job.occluder_triangles),
        "repaired": job.repairs,
        "seconds": meter.seconds,
        "peak_memory_bytes": peak_memory(),
        "wall_seconds": meter.elapsed,
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
