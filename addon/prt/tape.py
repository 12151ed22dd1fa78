"""What the rays of one bake found, kept so that another light needs none of them again.

The steps of a bake to vertices follow from its job alone, so what is asked comes in the same order
each time: the visibility of every place's rays, in one array a trace, what they meet where light
bounces, and the answers to ``meets_back``.  Which texels are traced follows from the light too:
what is known of these is on a ``PlaceTape``.
"""

from collections.abc import Callable, Mapping, Sequence
from typing import Any, Protocol

import numpy as np
import numpy.typing as npt

from .cache import Cache
from .tracing.rays import Mask, Occlusion, Vectors

Bits = npt.NDArray[np.uint8]
Known = npt.NDArray[np.bool_]
Ask = Callable[[Vectors, Vectors], Known]

LARGEST = 1 << 29  # bytes; what is larger is not kept


class Record(Protocol):
    """What is known of the rays of a bake: ``known`` where there is anything, with the ``report``
    that was saved with it."""

    known: bool
    report: dict[str, Any]

    def visibility(
        self, origins: Vectors, normals: Vectors, rays: int
    ) -> tuple[Bits | None, Known | None]:
        """Where the visibility (M, rays / 8) of M places is, or is to be put, and of which it is
        there (M,); None where nothing is kept."""
        ...

    def answers(self, ask: Ask, origins: Vectors, directions: Vectors) -> tuple[Known, int]:
        """What ``ask`` answers (M,), or answered, and of how many it had to be asked."""
        ...

    def save(self, report: dict[str, Any]) -> None:
        """Keep all that was found."""
        ...


class Tape:
    """A record that is asked for the same things in the same order each time: the one named ``key``
    of ``cache``, which is only read where it is known.  Without a key nothing is kept."""

    def __init__(self, cache: Cache, key: str) -> None:
        self._cache, self._key = cache, key
        entry = cache.get(key) if key else None
        self.known = entry is not None
        self.report: dict[str, Any] = entry.report if entry else {}
        self._arrays: dict[str, npt.NDArray[Any]] = dict(entry.arrays) if entry else {}
        self._asked = 0

    def visibility(
        self,
        origins: Vectors,
        normals: Vectors,  # noqa: ARG002 - told apart by their order
        rays: int,
    ) -> tuple[Bits | None, Known | None]:
        """See Record: of the next places."""
        if not self._key:
            return None, None
        name = self._next()
        if not self.known:
            self._arrays[name] = np.zeros((len(origins), -(-rays // 8)), np.uint8)
            self._forget_too_much()
        return self._arrays.get(name), np.full(len(origins), self.known)

    def answers(self, ask: Ask, origins: Vectors, directions: Vectors) -> tuple[Known, int]:
        """See Record."""
        if not self._key:
            return ask(origins, directions), len(origins)
        name = self._next()
        if self.known:
            bits = np.asarray(self._arrays[name], np.uint8)
            return np.unpackbits(bits, count=len(origins)).astype(bool), 0
        answer = ask(origins, directions)
        self._arrays[name] = np.packbits(answer)
        return answer, len(origins)

    @property
    def keeps(self) -> bool:
        """Whether it has a key, and room."""
        return bool(self._key)

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
    on a ``tape``; rays to the sky are there with their places.  ``asked`` is how many it was asked
    that were not."""

    def __init__(self, build: Callable[[], Occlusion], tape: Record) -> None:
        self._build, self._tape = build, tape
        self.asked = 0

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

    def meets_back(self, origins: Vectors, directions: Vectors) -> Known:
        """The occlusion's own, or what it was."""

        def ask(origins: Vectors, directions: Vectors) -> Known:
            return self._build().meets_back(origins, directions)

        found, asked = self._tape.answers(ask, origins, directions)
        self.asked += asked
        return found
