"""The light of a run, prepared for shiny surfaces."""

from collections.abc import Generator
from dataclasses import asdict, replace

import numpy as np

from .cache import Cache
from .job import Job, Peak, Progress
from .light.world import World
from .meter import Meter
from .results import Reflections
from .specular import sheet
from .specular.sheet import Sheet

PHASE = "reflections"


def reflections(
    job: Job, world: World, cache: Cache, meter: Meter
) -> Generator[Progress, None, Reflections]:
    """What is reflected of the light of ``job``.  The cache keeps it."""
    yield meter.progress(PHASE)
    with meter.phase(PHASE):
        key = f"{PHASE}-{world.key}" if world.key else ""
        known = cache.get(key) if key else None
        if known is not None:
            image, its_sheet = known.arrays["image"], Sheet.of(known.report)
        else:
            steps = sheet.fill(world.rest, job.settings.threads)
            its_sheet, values = yield from meter.alive(PHASE, steps)
            image = values.astype(np.float16)
            if key:
                cache.put(key, {"image": image}, asdict(its_sheet))
    peaks = tuple(_in_picture(peak, job) for peak in world.peaks)
    return Reflections(its_sheet, peaks, image)


def _in_picture(peak: Peak, job: Job) -> Peak:
    """``peak`` in the picture's frame, of a strength of 1."""
    assert job.light is not None
    strength = np.array(job.light.strength)
    some = np.divide(peak.irradiance, strength, out=np.zeros(3), where=strength != 0)
    (x, y, z), (r, g, b) = np.array(job.light.rotation) @ peak.direction, some
    return replace(
        peak,
        direction=(float(x), float(y), float(z)),
        irradiance=(float(r), float(g), float(b)),
    )
