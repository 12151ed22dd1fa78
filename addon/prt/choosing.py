"""Vertices or texels: where the values of a receiver are better off.

A pilot says how wrong values of the vertices alone would be between these.  In a texture the error
is less as its texels are nearer to each other than the vertices: a shadow's edge is that much
narrower.  Of the two the smaller is taken that stays within the error allowed, and where neither
does the one that is less wrong.
"""

from collections.abc import Generator
from dataclasses import asdict, dataclass, replace
from math import sqrt

import numpy as np

from .baking import Scene, Work, prepared
from .job import Carrier, Job, Progress
from .layout import Layout
from .surface.points import Points, Surface
from .tape import Tape

USED = 0.6  # of an atlas is surface, about
ALLOWED = 0.02  # relative error, where no tolerance was given
FLOAT_BYTES = 4


@dataclass(frozen=True)
class Choice:
    """What is predicted of a receiver on its vertices and in a texture: relative errors between
    these, and bytes in memory."""

    vertex_error: float
    texture_error: float
    vertex_bytes: int
    texture_bytes: int

    def carrier(self, allowed: float) -> Carrier:
        """The better of the two."""
        both: tuple[tuple[Carrier, float, int], ...] = (
            ("vertex", self.vertex_error, self.vertex_bytes),
            ("texture", self.texture_error, self.texture_bytes),
        )
        within = [one for one in both if one[1] <= allowed]
        if within:
            return min(within, key=lambda one: one[2])[0]
        return min(both, key=lambda one: one[1])[0]


def decided(scene: Scene) -> Generator[Progress, None, tuple[Job, dict[int, Choice]]]:
    """The scene's job, in which every receiver has a carrier, and what was predicted of those that
    had none.  Receivers that share materials are decided for together."""
    job = scene.job
    open_ones = [i for i, receiver in enumerate(job.receivers) if receiver.carrier == "auto"]
    areas = {i: float(Surface.of(job.receivers[i]).areas.sum()) for i in open_ones}
    choices: dict[int, Choice] = {}
    for index in open_ones:
        yield scene.meter.progress("choose")
        shared = open_ones if job.settings.shared_atlas else _mates(job, open_ones, index)
        share = areas[index] / max(sum(areas[i] for i in shared), 1e-300)
        choices[index] = yield from _choice(scene, index, areas[index], share)
    receivers = list(job.receivers)
    allowed = job.settings.tolerance or ALLOWED
    for index in open_ones:
        together = _together([choices[i] for i in _mates(job, open_ones, index)])
        receivers[index] = replace(receivers[index], carrier=together.carrier(allowed))
    return replace(job, receivers=tuple(receivers)), choices


def report(choice: Choice) -> dict[str, float]:
    """``choice`` as the report has it."""
    return asdict(choice)


def _mates(job: Job, among: list[int], index: int) -> list[int]:
    """Those ``among`` the receivers that share materials with ``index``, itself included."""
    group = job.receivers[index].group
    return [i for i in among if i == index or (group >= 0 and job.receivers[i].group == group)]


def _together(choices: list[Choice]) -> Choice:
    """Several as one: the worst errors and all bytes."""
    return Choice(
        max(choice.vertex_error for choice in choices),
        max(choice.texture_error for choice in choices),
        sum(choice.vertex_bytes for choice in choices),
        sum(choice.texture_bytes for choice in choices),
    )


def _choice(
    scene: Scene, index: int, area: float, share: float
) -> Generator[Progress, None, Choice]:
    """What is predicted of receiver ``index`` with its ``area``, which is a ``share`` of its
    atlas."""
    job, receiver = scene.job, scene.job.receivers[index]
    settings = job.settings
    points = prepared(receiver)
    error = yield from _vertex_error(scene, index, points)
    if settings.texel_density:
        texels = area * settings.texel_density**2
    else:
        texels = USED * share * settings.resolution**2
    spacing = sqrt(len(points.origins) / max(texels, 1.0))
    turns, visibility = scene.world.turns, settings.visibility_order
    slots = len(Layout(settings.order, scene.channels, turns, settings.peaks, visibility).slots)
    return Choice(
        error,
        error * min(1.0, spacing),
        len(receiver.normals) * slots * FLOAT_BYTES,
        round(texels / USED * slots * FLOAT_BYTES),
    )


def _vertex_error(scene: Scene, index: int, points: Points) -> Generator[Progress, None, float]:
    """The pilot's error, or what it was."""
    key = scene.pilot_key(index, points)
    known = scene.cache.get(key) if key else None
    if known is not None:
        return float(known.report["error"])
    work = Work(scene, index, points, Tape(scene.cache, ""))
    with scene.meter.phase("choose"):
        error = yield from scene.meter.follow("choose", work.interpolation_error(), 0, 1)
    if key:
        scene.cache.put(key, {"none": np.zeros(1, np.uint8)}, {"error": error})
    return error
