"""Which rays are looked at, and where what they meet is kept."""

from collections.abc import Callable, Generator, Mapping, Sequence
from dataclasses import replace
from typing import Any, Protocol

import numpy as np
import numpy.typing as npt

from ..job import Settings
from ..surface.points import Points
from ..tracing.looking import Look
from ..tracing.rays import Geometry, Occlusion
from ..tracing.transfer import Counts, Shortcuts, trace_all
from .chunks import Chunk, split
from .entries import Entries
from .hits import Again, Budget, Gathered, Kept, Meeting, Recorder

Array = npt.NDArray[np.float32]
Retrace = Callable[[Look], Generator[int, None, None]]

SHOWN, ENOUGH = 2, 32  # of so many rays one is looked at, as long as these are enough of a place
HITS = ("numbers", "others", "entries", "local")


class Memory(Protocol):
    """Keeps arrays from one bake to the next, as a tape does."""

    @property
    def known(self) -> bool:
        """Whether there is something to be read."""
        ...

    @property
    def keeps(self) -> bool:
        """Whether it has room for anything."""
        ...

    def recall(self, names: Sequence[str]) -> list[npt.NDArray[Any]]:
        """The next arrays."""
        ...

    def keep(self, arrays: Mapping[str, npt.NDArray[Any]] | None) -> None:
        """Keep the next arrays, None where that is too much."""
        ...


class Trace(Protocol):
    """Traces places, ``rays`` each; whether what they meet is looked at."""

    def __call__(
        self, places: Points, rays: int, look: bool
    ) -> Generator[int, None, tuple[Array, Gathered | None, Counts]]:
        """Yields the rays cast so far; the value is what was found, (M, K), what was met, and the
        rays by reason."""
        ...


class Keeper:
    """Hands out what looks at rays, and takes back what they met."""

    def __init__(
        self,
        geometry: Callable[[], Geometry],
        entries: Entries,
        seed: int,
        threads: int,
        budget: Budget | None = None,
    ) -> None:
        self.meeting = Meeting(geometry, entries, seed)
        self._threads, self._budget = threads, budget or Budget()

    def recorder(self) -> Recorder:
        """A Look for the rays of some places."""
        return Recorder(self.meeting, self._budget)

    def _taken(self, recorder: Recorder, count: int, trace: Retrace) -> Gathered:
        """What ``recorder`` saw of ``count`` places, which ``trace`` traces again where that was
        too much to be kept."""
        chunks = recorder.chunks()
        if chunks is None:
            return Again(count, trace, self.meeting)
        return Kept(count, self._threads, chunks)

    def remembered(self, count: int, hits: Chunk) -> Kept:
        """What was kept of ``count`` places on a tape."""
        return Kept(count, self._threads, split(hits))

    def keep(
        self, memory: Memory, recorder: Recorder | None, count: int, again: Retrace
    ) -> Gathered:
        """What ``recorder`` saw of ``count`` places, or, where ``memory`` is known, what was seen
        when it was filled."""
        if recorder is None:
            return self.remembered(count, Chunk(*memory.recall(HITS)))
        met = self._taken(recorder, count, again)
        if memory.keeps:
            memory.keep(recorder.arrays())
        return met

    @staticmethod
    def retrace(
        places: Points, occlusion: Occlusion, settings: Settings, shortcuts: Shortcuts
    ) -> Retrace:
        """What traces ``places`` again, ray by ray as they were, for someone who looks at the
        rays."""
        coarse = replace(settings, order=1)

        def trace(look: Look) -> Generator[int, None, None]:
            scratch = np.empty((len(places.origins), 1), np.float32)
            anew = Shortcuts(shortcuts.horizon, look=look, shown=shortcuts.shown)
            yield from trace_all(places, occlusion, coarse, scratch, shortcuts=anew)

        return trace

    @staticmethod
    def shown_of(rays: int) -> int:
        """Of how many rays of a point that has ``rays`` one is looked at: what arrives from other
        surfaces changes less from direction to direction than what reaches the sky, and to find
        where a ray ends takes longer than to find that it ends.  One of four would save little
        more, and the noise of all light together would be a fifth larger instead of a
        twenty-fifth."""
        return SHOWN if rays >= SHOWN * ENOUGH else 1
