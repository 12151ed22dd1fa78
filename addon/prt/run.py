"""A run of the engine, from a job to its results, as a generator of progress."""

import platform
import sys
from collections.abc import Generator, Sequence
from dataclasses import asdict, replace
from typing import Any

import numpy as np

from . import VERSION, bands
from .baking import Baked, Scene, bake
from .bounced import bake_all
from .bounces.walks import Walls
from .cache import Cache
from .files import images
from .job import Job, Progress, Receiver, content_hash
from .light.world import World
from .meter import Meter
from .results import ReceiverResult, Results
from .surface.points import Points, distinct_points
from .tracing import rays
from .verify import measure
from .vertex.traced import Traced

Entry = dict[str, Any]


def run(job: Job) -> Generator[Progress, None, Results]:
    """Do ``job``; its results are the generator's value.  ``close()`` cancels it."""
    meter = Meter(work=_work(job))
    report: dict[str, Any] = {"job_hash": content_hash(job), "objects": []}
    yield meter.progress("light")
    cache = Cache(job.settings.cache)
    world = World(job, cache)
    with meter.phase("light"):
        image_sh = world.image_sh
    scene = Scene(job, world, cache, meter)
    receivers: Sequence[ReceiverResult] = ()
    if job.kind == "bake":
        receivers = yield from _bake(scene, report["objects"])
        receivers = _with_needed_bands(scene, receivers, report["objects"])
    elif job.kind == "verify":
        yield from _verify(scene, report["objects"])
    if job.light is not None:
        report["light"] = world.report
    report.update(_run_report(job, meter))
    return Results(image_sh, tuple(receivers), report, world.peaks)


def _work(job: Job) -> float:
    """All that is to be done, in points; as ``_bake`` and ``_verify`` count it."""
    points = sum(len(r.normals) for r in job.receivers) if job.kind == "bake" else 0
    return max(1.0, points + len(job.receivers) * _verify_work(job))


def _verify_work(job: Job) -> float:
    """What measuring one receiver is, in points."""
    settings = job.settings
    return 2 * settings.verify_points * settings.verify_rays / settings.rays


def _bake(scene: Scene, entries: list[Entry]) -> Generator[Progress, None, list[ReceiverResult]]:
    """Bake every receiver, with an entry of the report for each."""
    if scene.job.bounces:
        bakes = yield from bake_all(scene)
    else:
        bakes = []
    results = []
    for index, receiver in enumerate(scene.job.receivers):
        if scene.job.bounces:
            baked = bakes[index]
        else:
            yield scene.meter.progress("prepare")
            baked = yield from bake(scene, index)
        scene.meter.work += len(baked.points.origins) - len(receiver.normals)
        if scene.job.settings.verify_points:
            yield from _measure_bake(scene, receiver, baked)
        results.append(baked.result)
        entries.append(baked.entry)
    return results


def _measure_bake(
    scene: Scene, receiver: Receiver, baked: Baked
) -> Generator[Progress, None, None]:
    """Let the report of ``baked`` say what a second look at its points finds."""
    result = baked.result
    shown = replace(
        receiver,
        transfer=result.at_elements(result.transfer),
        residual=result.at_elements(result.residual),
    )
    traced = baked.solved.traced if baked.solved else None
    baked.entry["measured_error"] = yield from _measure(scene, shown, baked.points, traced)


def _verify(scene: Scene, entries: list[Entry]) -> Generator[Progress, None, None]:
    """Measure every receiver as it is shown."""
    for receiver in scene.job.receivers:
        measured = yield from _measure(scene, receiver, distinct_points(receiver), None)
        entries.append({"name": receiver.name, "measured_error": measured})


def _measure(
    scene: Scene, receiver: Receiver, points: Points, traced: Traced | None
) -> Generator[Progress, None, Entry]:
    """The measured errors of what ``receiver`` shows."""
    settings = scene.job.settings
    with scene.meter.phase("verify"):
        walls, occlusion = _walls(scene), scene.occlusion.watertight()
        light = None if walls else scene.world.reference(occlusion)
        steps = measure(
            receiver, points, occlusion, settings, traced=traced, light=light, walls=walls
        )
        expected = 2 * settings.verify_points * settings.verify_rays
        share = _verify_work(scene.job)
        measured = yield from scene.meter.follow("verify", steps, share, expected)
    return asdict(measured)


def _walls(scene: Scene) -> Walls | None:
    """What light bounces off, if it does."""
    job = scene.job
    if not job.bounces:
        return None
    vertices = np.asarray(job.occluder_vertices, np.float32)
    return Walls(scene.occlusion, vertices, job.occluder_triangles, job.occluder_albedo)


def _with_needed_bands(
    scene: Scene, results: Sequence[ReceiverResult], entries: list[Entry]
) -> Sequence[ReceiverResult]:
    """``results`` without the bands that make no difference, where such can be told."""
    settings = scene.job.settings
    if not (settings.tolerance or settings.final_light) or not results:
        return results
    seen = scene.world.seen_sh if scene.job.light is not None else np.zeros((1, 25, 3))
    final = seen[0] if settings.final_light else None
    order = bands.needed_order(results, settings.tolerance, final)
    for entry in entries:
        entry["bands_left_out"] = settings.order - order
    return [bands.cut(result, order, seen) for result in results]


def _run_report(job: Job, meter: Meter) -> dict[str, Any]:
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
    found = {"prt_baker": VERSION, "python": platform.python_version(), "numpy": np.__version__}
    return found | {"embreex": rays.version(), "OpenEXR": images.version()}


def peak_memory() -> int | None:
    """The largest resident size of this process so far in bytes; None on Windows."""
    if sys.platform == "win32":
        return None
    import resource

    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return int(peak if sys.platform == "darwin" else peak * 1024)
