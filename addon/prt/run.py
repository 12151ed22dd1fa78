"""A run of the engine, from a job to its results, as a generator of progress."""

import platform
import sys
from collections.abc import Generator, Sequence
from dataclasses import asdict, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from . import VERSION, bands, choosing
from .baking import Baked, Scene, bake
from .bounces.walks import Walls
from .cache import Cache
from .files import images
from .job import Job, Progress, Receiver, content_hash
from .light.world import World
from .meter import Meter
from .reflecting import reflections
from .results import Atlas, ReceiverResult, Results
from .surface.points import Points, distinct_points
from .surface.samples import Places
from .tracing import rays
from .verify import Shown, measure, shown_at
from .vertex.traced import Traced

if TYPE_CHECKING:
    from .texturing import Sheet  # and all else of it where there are textures

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
    atlases: list[Atlas] = []
    if job.kind == "bake":
        scene.job, choices = yield from choosing.decided(scene)
        meter.work = _work(scene.job)
        receivers, sheets = yield from _bake(scene, report["objects"])
        for index, choice in choices.items():
            report["objects"][index]["predicted"] = choosing.report(choice)
        receivers = _with_needed_bands(scene, receivers, report["objects"])
        atlases = yield from _painted(scene, sheets, receivers)
    elif job.kind == "verify":
        yield from _verify(scene, report["objects"])
    is_shown = job.kind != "verify"
    reflected = (yield from reflections(job, world, cache, meter)) if is_shown else None
    if job.light is not None:
        report["light"] = world.report
    report.update(_run_report(job, meter))
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
    return max(1.0, points + len(job.receivers) * _verify_work(job))


def _in(job: Job, carrier: str) -> list[int]:
    """The receivers whose values lie in a ``carrier``."""
    return [i for i, receiver in enumerate(job.receivers) if receiver.carrier == carrier]


def _verify_work(job: Job) -> float:
    """What measuring one receiver is, in points."""
    settings = job.settings
    return 2 * settings.verify_points * settings.verify_rays / settings.rays


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
            yield from _measure_bake(scene, receiver, bakes[index])
    sheets = (yield from _bake_textures(scene, in_textures, bakes)) if in_textures else []
    entries += [bakes[index].entry for index in sorted(bakes)]
    return [bakes[index].result for index in sorted(bakes)], sheets


def _bake_textures(
    scene: Scene, in_textures: list[int], bakes: dict[int, Baked]
) -> Generator[Progress, None, "list[Sheet]"]:
    """The sheets of the receivers ``in_textures``, which are put into ``bakes``."""
    from . import texturing
    from .bounced import Surfaces

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
                yield from _measure_texels(scene, index, sheet, bakes[index])
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


def _measure_texels(
    scene: Scene, index: int, sheet: "Sheet", baked: Baked
) -> Generator[Progress, None, None]:
    """As ``_measure_bake``, between texels."""
    from . import texturing

    receiver, settings = scene.job.receivers[index], scene.job.settings
    count, seed = settings.verify_points, settings.seed
    shown = texturing.between_texels(receiver, baked.result, sheet.size, count, seed)
    traced = baked.solved.traced if baked.solved else None
    baked.entry["measured_error"] = yield from _measure(scene, receiver, None, traced, shown)


def _measure_bake(
    scene: Scene, receiver: Receiver, baked: Baked
) -> Generator[Progress, None, None]:
    """Let the report of ``baked`` say what a second look at its points finds."""
    result = baked.result
    shown = replace(
        receiver,
        transfer=result.at_elements(result.transfer),
        residual=result.at_elements(result.residual),
        visibility_sh=result.at_elements(result.visibility_sh),
    )
    traced = baked.solved.traced if baked.solved else None
    baked.entry["measured_error"] = yield from _measure(scene, shown, baked.points, traced)


def _verify(scene: Scene, entries: list[Entry]) -> Generator[Progress, None, None]:
    """Measure every receiver as it is shown."""
    for receiver in scene.job.receivers:
        points = distinct_points(receiver) if receiver.places is None else None
        surface = _at_places(receiver) if receiver.places is not None else None
        measured = yield from _measure(scene, receiver, points, None, surface)
        entries.append({"name": receiver.name, "measured_error": measured})


def _at_places(receiver: Receiver) -> Shown:
    """What ``receiver`` is said to show at its ``places``."""
    assert receiver.places is not None
    assert receiver.transfer is not None
    places = Places(receiver.places[:, 0].astype(np.int64), np.asarray(receiver.places[:, 1:]))
    residual = receiver.residual
    has_residual = residual is not None and residual.shape[1]
    return shown_at(
        receiver,
        places,
        receiver.transfer.astype(np.float64),
        residual[:, 0].astype(np.float64) if residual is not None and has_residual else None,
        None if receiver.visibility_sh is None else receiver.visibility_sh.astype(np.float64),
    )


def _measure(
    scene: Scene,
    receiver: Receiver,
    points: Points | None,
    traced: Traced | None,
    surface: Shown | None = None,
) -> Generator[Progress, None, Entry]:
    """The measured errors of what ``receiver`` shows."""
    settings = scene.job.settings
    with scene.meter.phase("verify"):
        walls, occlusion = _walls(scene), scene.occlusion.watertight()
        light = None if walls else scene.world.reference(occlusion)
        steps = measure(
            receiver,
            points,
            occlusion,
            settings,
            traced=traced,
            light=light,
            walls=walls,
            surface=surface,
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
