"""What surrounds receivers in textures, and sends light back to them."""

from collections.abc import Generator, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from .baking import Far, Scene, prepared
from .bounced import Bounces, far_of, unbaked_key
from .bounces.entries import Entries
from .bounces.hits import Leaving
from .job import Progress
from .tape import Tape


class Surfaces:
    """What surrounds receivers in textures, ``indices`` of the scene's job, and sends light back to
    them.  ``far`` names what this depends on."""

    def __init__(self, scene: Scene, indices: Sequence[int]) -> None:
        self._scene, self._indices = scene, indices
        self._entries = Entries.of(scene.job, ())
        self.far = far_of(scene.job, self._entries) if scene.job.settings.cache else Far()
        self.report: dict[str, Any] = {}
        self._leaving: Leaving | None = None

    def leaving(self) -> Generator[Progress, None, Leaving]:
        """All light that leaves them, which is followed the first time."""
        if self._leaving is None:
            bounces = Bounces(self._scene, (), self._entries, Tape(self._scene.cache, self._key()))
            with self._scene.meter.phase("bounces"):
                yield from bounces.unbaked((yield from bounces.glanced(self._indices)))
                sources, total = yield from bounces.follow()
            self._leaving, self.report = bounces.leaving(sources, total)
        return self._leaving

    def _key(self) -> str:
        """Names what is traced of them."""
        if not self._scene.job.settings.cache:
            return ""
        glances = np.array(self._indices, np.int64).tobytes()
        points = prepared(self._scene.job.receivers[self._indices[0]])
        return unbaked_key(self._scene, points, replace(self.far, rays=self.far.rays + glances))
