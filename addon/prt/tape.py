"""What the rays of one bake found, kept so that another light needs none of them again.

The steps of a bake follow from its job alone, so what is asked comes in the same order each time:
the visibility of every place's rays, in one array a trace, what they meet where light bounces, and
the answers to ``meets_back``.
"""

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from .cache import Cache
from .tracing.rays import Mask, Occlusion, Vectors

Bits = npt.NDArray[np.uint8]

LARGEST = 1 << 29  # bytes; what is larger is not kept


class Tape:
    """The tape named ``key`` of ``cache``: ``known`` where it is there to be read, with the
    ``report`` that was saved with it.  Without a key nothing is kept."""

    def __init__(self, cache: Cache, key: str) -> None:
        self._cache, self._key = cache, key
        entry = cache.get(key) if key else None
        self.known = entry is not None
        self.report: dict[str, Any] = entry.report if entry else {}
        self._arrays: dict[str, npt.NDArray[Any]] = dict(entry.arrays) if entry else {}
        self._asked = 0

    def visibility(self, count: int, rays: int) -> Bits | None:
        """Where the visibility (count, rays / 8) of the next places is, or is to be put."""
        if not self._key:
            return None
        name = self._next()
        if not self.known:
            self._arrays[name] = np.zeros((count, -(-rays // 8)), np.uint8)
            self._forget_too_much()
        return self._arrays.get(name)

    def answers(self, ask: Callable[[], npt.NDArray[np.bool_]], count: int) -> Any:
        """What ``ask`` answers (count,), or answered."""
        if not self._key:
            return ask()
        name = self._next()
        if self.known:
            return np.unpackbits(self._arrays[name], count=count).astype(bool)
        answer = ask()
        self._arrays[name] = np.packbits(answer)
        return answer

    def recall(self, names: Sequence[str]) -> list[npt.NDArray[Any]]:
        """The next arrays that were kept under ``names``; only where the tape is known."""
        place = self._next()
        return [self._arrays[f"{place} {name}"] for name in names]

    def keep(self, arrays: Mapping[str, npt.NDArray[Any]] | None) -> None:
        """Keep ``arrays`` as the next ones; None were too many, so that nothing can be kept."""
        if not self._key:
            return
        place = self._next()
        if arrays is None:
            self._key, self._arrays = "", {}
            return
        self._arrays.update({f"{place} {name}": array for name, array in arrays.items()})
        self._forget_too_much()

    def save(self, report: dict[str, Any]) -> None:
        """Keep all that was found."""
        if self._key and not self.known:
            self._cache.put(self._key, self._arrays, report)

    def _next(self) -> str:
        self._asked += 1
        return str(self._asked)

    def _forget_too_much(self) -> None:
        if sum(array.nbytes for array in self._arrays.values()) > LARGEST:
            self._key, self._arrays = "", {}


class Remembered:
    """An occlusion that is built when it is first needed, and whose answers to ``meets_back`` are
    on a tape; rays to the sky are there with their places."""

    def __init__(self, build: Callable[[], Occlusion], tape: Tape) -> None:
        self._build, self._tape = build, tape

    def sky_mask(self, origins: Vectors, directions: Vectors) -> Mask:
        """The occlusion's own."""
        return self._build().sky_mask(origins, directions)

    @property
    def lets_slip(self) -> bool:
        """As the occlusion's own."""
        return self._build().lets_slip

    def watertight(self) -> Occlusion:
        """The occlusion's own."""
        return self._build().watertight()

    def meets_back(self, origins: Vectors, directions: Vectors) -> npt.NDArray[np.bool_]:
        """The occlusion's own, or what it was."""
        found: npt.NDArray[np.bool_] = self._tape.answers(
            lambda: self._build().meets_back(origins, directions), len(origins)
        )
        return found
