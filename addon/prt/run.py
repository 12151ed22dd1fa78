"""A run of the engine, from a job to its results, as a generator of progress.

What not every job needs is imported where it is needed: that of all would take as long as some
million rays.
"""

import platform
import sys
from collections.abc import Generator, Sequence
from dataclasses import asdict
from typing import TYPE_CHECKING, Any

import numpy as np

from . import VERSION
from .baking import Baked, Scene, bake
from .cache import Cache
from .job import Job, Progress, content_hash
from .light.world import World
from .meter import Meter
from .packages import wheel_version
from .parallel import workers
from .results import Atlas, ReceiverResult, Results

if TYPE_CHECKING:
    from .texturing import Sheet

Entry = dict[str, Any]


def run(job: Job) -> Generator[Progress, None, Results]:
    """Do ``job``; its results are the generator's value.  ``close()`` cancels it."""
    meter = Meter(work=_work(job))
    pool = workers(1)
    job_hash = pool.submit(content_hash, job)
    pool.shutdown(wait=False)
    report: dict[str, Any] = {"objects": []}
    yield meter.progress("light")
    cache = Cache(job.settings.cache)
    world = World(job, cache)
    with meter.phase("light"):
        image_sh = world.image_sh
    scene = Scene(job, world, cache, meter)
    receivers: Sequence[ReceiverResult] = ()
    atlases: list[Atlas] = []
    if job.kind == "bake":
        predicted = yield from _decide(scene)
        receivers, sheets = yield from _bake(scene, report["objects"])
        for index, its in predicted.items():
            report["objects"][index]["predicted"] = its
        receivers = _with_needed_bands(scene, receivers, report["objects"])
        atlases = yield from _painted(scene, sheets, receivers)
    elif job.kind == "verify":
        from .measuring import verify

        yield from verify(scene, report["objects"])
    reflected = None
    if job.settings.reflections and job.light is not None and job.kind != "verify":
        from .reflecting import reflections

        reflected = yield from reflections(job, world, cache, meter)
    if job.light is not None:
        report["light"] = world.report
    report.update(_run_report(job, meter), job_hash=job_hash.result())
    return Results(image_sh, tuple(receivers), report, world.peaks, tuple(atlases), reflected)


def _work(job: Job) -> float:
    """All that is to be done, in points; as ``_bake`` and ``_verify`` count it."""
    points = 0.0
    if job.kind == "bake":
        points = sum(len(job.receivers[i].normals) for i in _in(job, "vertex"))
        in_textures = _in(job, "texture")
        if in_textures:
            from . import texturing

            points += texturing.work_of(job, in_textures)
    return max(1.0, points + len(job.receivers) * job.settings.verify_work)


def _in(job: Job, carrier: str) -> list[int]:
    """The receivers whose values lie in a ``carrier``."""
    return [i for i, receiver in enumerate(job.receivers) if receiver.carrier == carrier]


def _decide(scene: Scene) -> Generator[Progress, None, dict[int, Entry]]:
    """Give the receivers of the scene's job that have no carrier one; what was predicted of each
    of these."""
    if not _in(scene.job, "auto"):
        return {}
    from . import choosing

    scene.job, choices = yield from choosing.decided(scene)
    scene.meter.work = _work(scene.job)
    return {index: choosing.report(choice) for index, choice in choices.items()}


def _bake(
    scene: Scene, entries: list[Entry]
) -> Generator[Progress, None, tuple[list[ReceiverResult], "list[Sheet]"]]:
    """Bake every receiver, with an entry of the report for each, and lay out the atlases."""
    on_vertices, in_textures = (_in(scene.job, carrier) for carrier in ("vertex", "texture"))
    bakes: dict[int, Baked] = {}
    if scene.job.bounces and on_vertices:
        from .bounced import bake_all

        found = yield from bake_all(scene.only(on_vertices))
        bakes = dict(zip(on_vertices, found, strict=True))
    for index in on_vertices:
        receiver = scene.job.receivers[index]
        if not scene.job.bounces:
            yield scene.meter.progress("prepare")
            bakes[index] = yield from bake(scene, index)
        scene.meter.work += len(bakes[index].points.origins) - len(receiver.normals)
        if scene.job.settings.verify_points:
            from .measuring import measure_bake

            yield from measure_bake(scene, receiver, bakes[index])
    sheets = (yield from _bake_textures(scene, in_textures, bakes)) if in_textures else []
    entries += [bakes[index].entry for index in sorted(bakes)]
    return [bakes[index].result for index in sorted(bakes)], sheets


def _bake_textures(
    scene: Scene, in_textures: list[int], bakes: dict[int, Baked]
) -> Generator[Progress, None, "list[Sheet]"]:
    """The sheets of the receivers ``in_textures``, which are put into ``bakes``."""
    from . import texturing
    from .surfaces import Surfaces

    surfaces = Surfaces(scene, in_textures) if scene.job.bounces else None
    sheets = []
    for number, plan in enumerate(texturing.plans(scene.job, in_textures)):
        yield scene.meter.progress("unwrap")
        sheet = yield from texturing.laid_out(scene, plan)
        sheets.append(sheet)
        for index in plan.receivers:
            yield scene.meter.progress("prepare")
            bakes[index] = yield from texturing.bake_texels(scene, index, sheet, number, surfaces)
            if scene.job.settings.verify_points:
                from .measuring import measure_texels

                yield from measure_texels(scene, index, sheet, bakes[index])
    return sheets


def _painted(
    scene: Scene, sheets: "list[Sheet]", receivers: Sequence[ReceiverResult]
) -> Generator[Progress, None, list[Atlas]]:
    """The atlases, filled."""
    if not sheets:
        return []
    from . import texturing

    atlases = []
    for number, sheet in enumerate(sheets):
        yield scene.meter.progress("fill")
        with scene.meter.phase("fill"):
            steps = texturing.painted(sheet, receivers, number, scene.job.settings)
            atlases.append((yield from scene.meter.alive("fill", steps)))
    yield scene.meter.progress("write")
    return atlases


def _with_needed_bands(
    scene: Scene, results: Sequence[ReceiverResult], entries: list[Entry]
) -> Sequence[ReceiverResult]:
    """``results`` without the bands that make no difference, where such can be told."""
    settings = scene.job.settings
    if not (settings.tolerance or settings.final_light) or not results:
        return results
    from . import bands

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
    return found | {package: wheel_version(package) for package in ("embreex", "OpenEXR")}


def peak_memory() -> int | None:
    """The largest resident size of this process so far in bytes; None on Windows."""
    if sys.platform == "win32":
        return None
    import resource

    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return int(peak if sys.platform == "darwin" else peak * 1024)
