"""What a second look at bakes finds of their errors."""

from collections.abc import Generator
from dataclasses import asdict, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from .baking import Baked, Scene
from .bounces.walks import Walls
from .job import Progress, Receiver
from .surface.points import Points, distinct_points
from .surface.samples import Places
from .verify import Shown, measure, shown_at
from .vertex.traced import Traced

if TYPE_CHECKING:
    from .texturing import Sheet

Entry = dict[str, Any]


def measure_texels(
    scene: Scene, index: int, sheet: "Sheet", baked: Baked
) -> Generator[Progress, None, None]:
    """As ``measure_bake``, between texels."""
    from . import texturing

    receiver, settings = scene.job.receivers[index], scene.job.settings
    count, seed = settings.verify_points, settings.seed
    shown = texturing.between_texels(receiver, baked.result, sheet.size, count, seed)
    traced = baked.solved.traced if baked.solved else None
    baked.entry["measured_error"] = yield from _measure(scene, receiver, None, traced, shown)


def measure_bake(scene: Scene, receiver: Receiver, baked: Baked) -> Generator[Progress, None, None]:
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


def verify(scene: Scene, entries: list[Entry]) -> Generator[Progress, None, None]:
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
        share = settings.verify_work
        measured = yield from scene.meter.follow("verify", steps, share, expected)
    return asdict(measured)


def _walls(scene: Scene) -> Walls | None:
    """What light bounces off, if it does."""
    job = scene.job
    if not job.bounces:
        return None
    vertices = np.asarray(job.occluder_vertices, np.float32)
    return Walls(scene.occlusion, vertices, job.occluder_triangles, job.occluder_albedo)
