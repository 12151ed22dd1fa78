"""The light of a job: its coefficients, and what residuals are residuals of."""

from dataclasses import dataclass
from functools import cached_property
from math import pi
from typing import Any

import numpy as np
import numpy.typing as npt

from . import light
from .cache import Cache
from .exact import ExactLight
from .gather import LightGather
from .job import Job, LightSource, light_digest
from .light import Projected, world_sh
from .residual import turned

Array = npt.NDArray[np.float32]
Float = npt.NDArray[np.float64]


@dataclass(frozen=True)
class ExactWorld:
    """``gather`` finds the exact exit radiance of white surfaces under the world in each of its
    turns about Z; ``radiance_sh`` (turns, 25, 3) are their coefficients."""

    gather: LightGather
    radiance_sh: Float

    def leave_residuals(self, values: Array, coefficients: int) -> None:
        """Turn the gathered columns of ``values`` (P, n² + 3 turns), after the n² ``coefficients``
        of the transfer, into what the transfer misses of them."""
        transfer = values[:, :coefficients]
        for k, radiance in enumerate(self.radiance_sh):
            place = slice(coefficients + 3 * k, coefficients + 3 * k + 3)
            values[:, place] -= transfer @ radiance[:coefficients].astype(np.float32)


class World:
    """The light of ``job``, projected unless ``cache`` knows its coefficients already."""

    def __init__(self, job: Job, cache: Cache) -> None:
        self._source: LightSource | None = job.light
        self._settings = job.settings
        self.is_exact = (
            job.kind == "bake"
            and job.settings.residual
            and job.light is not None
            and (job.light.image is not None or job.light.pixels is not None)
        )
        self.image_sh: Float | None = None
        self.report: dict[str, Any] = {}
        if job.light is None:
            return
        key = f"light-{light_digest(job.light).hex()}" if job.settings.cache else ""
        known = cache.get(key) if key else None
        if known is not None:
            self.image_sh, self.report = np.array(known.arrays["image_sh"]), known.report
            return
        self.image_sh = self._projected.image_sh
        self.report = {
            "projection": "cubemap" if self._projected.is_cubemap else "lat-long",
            "width": self._projected.width,
            "height": self._projected.height,
            "repaired": self._projected.repairs,
        }
        if key:
            cache.put(key, {"image_sh": self.image_sh}, self.report)

    @cached_property
    def _projected(self) -> Projected:
        assert self._source is not None
        return light.project(self._source)

    @property
    def radiance_sh(self) -> Float | None:
        """Coefficients (25, 3) of the world as it stands; None without a light."""
        if self._source is None or self.image_sh is None:
            return None
        return world_sh(self.image_sh, self._source.strength, self._source.rotation)

    @property
    def turns_sh(self) -> Float:
        """Coefficients (turns, 25, 3) of the world in all turns that residuals are baked for."""
        radiance = self.radiance_sh
        if not self.is_exact or radiance is None:
            return np.empty((0, 25, 3))
        return np.array([turned(radiance, angle) for angle in self._angles])

    @property
    def _angles(self) -> Float:
        return 2 * pi * np.arange(self._settings.turns) / self._settings.turns

    @cached_property
    def exact(self) -> ExactWorld | None:
        """None where nothing is asked for, or the world is a colour, which coefficients hold."""
        if not self.is_exact or self._source is None:
            return None
        pixels, settings = self._projected.pixels, self._settings
        assert pixels is not None
        rotation = np.asarray(self._source.rotation, np.float64)
        first = ExactLight(
            pixels, rotation, self._source.strength, settings.map_rays, settings.seed
        )
        turns = [first.turned(rotation @ _about_z(-angle)) for angle in self._angles[1:]]
        return ExactWorld(LightGather([first, *turns], settings.seed), self.turns_sh)


def _about_z(angle: float) -> Float:
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
