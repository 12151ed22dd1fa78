"""What the rays of texels found, kept by where they start: which texels are traced follows from the
light too, so a later bake asks for others among them, in another order."""

from collections.abc import Mapping, Sequence
from threading import Lock
from typing import Any

import numpy as np
import numpy.typing as npt

from .cache import Cache
from .tape import LARGEST, Ask, Bits, Known
from .tracing import identity
from .tracing.rays import Vectors

Index = npt.NDArray[np.int64]
Ends = npt.NDArray[Any]
Arrays = Mapping[str, npt.NDArray[Any]]

OF_ENDS = ("counts", "starts", "ends")


class PlaceTape:
    """A record, as a Tape is, that is asked for some places, in any order: the one named ``key`` of
    ``cache``.  What it did not know yet is added to it, as long as there is room for all of that.
    Without a key nothing is kept."""

    def __init__(self, cache: Cache, key: str) -> None:
        self._cache, self._key = cache, key
        entry = cache.get(key) if key else None
        self.known = entry is not None
        self.report: dict[str, Any] = entry.report if entry else {}
        self.old: Arrays = entry.arrays if entry else {}
        self._new: dict[str, list[tuple[identity.Keys, Bits, Known]]] = {}
        self._ends: dict[str, list[RayEnds]] = {}
        self._room = LARGEST - sum(array.nbytes for array in self.old.values()) if key else -1
        self._lock = Lock()

    def visibility(
        self, origins: Vectors, normals: Vectors, rays: int
    ) -> tuple[Bits | None, Known | None]:
        """See Record."""
        if not self._key:
            return None, None
        return self._recall(str(rays), identity.keys(origins, normals), -(-rays // 8))

    def answers(self, ask: Ask, origins: Vectors, directions: Vectors) -> tuple[Known, int]:
        """See Record."""
        if not self._key:
            return ask(origins, directions), len(origins)
        bits, known = self._recall("backs", identity.keys(origins, directions), 1)
        left = np.flatnonzero(~known)
        if len(left):
            bits[left, 0] = ask(origins[left], directions[left])
        return bits[:, 0] > 0, len(left)

    def ends(self, origins: Vectors, normals: Vectors, rays: int) -> "RayEnds":
        """Where the ``rays`` of places end whose visibility is known, and room for the others'."""
        found = RayEnds(self, str(rays), identity.keys(origins, normals))
        self._ends.setdefault(str(rays), []).append(found)
        return found

    def has_room_for(self, size: int) -> bool:
        """Whether ``size`` bytes more can be kept, which are counted; where they cannot, nothing
        new is.  Safe to call from several threads."""
        with self._lock:
            self._room -= size
            if self._room < 0:
                self._new.clear()
                self._ends.clear()
            return self._room >= 0

    def save(self, report: dict[str, Any]) -> None:
        """See Record."""
        added = {name: _unknown(some) for name, some in self._new.items()}
        added = {name: both for name, both in added.items() if len(both[0])}
        if not added or not self.has_room_for(0):
            return
        arrays = dict(self.old)
        for name, (keys, bits) in added.items():
            before = arrays.get(f"{name} keys", keys[:0])
            every = np.concatenate([before, keys])
            arrays[f"{name} keys"], first = np.unique(every, return_index=True)
            old_bits = arrays.get(f"{name} bits", bits[:0])
            arrays[f"{name} bits"] = np.concatenate([old_bits, bits])[first]
            if name in self._ends:
                names = [f"{name} {what}" for what in OF_ENDS]
                old = [arrays[its] for its in names if its in arrays]
                found = _joined(old, before, arrays[f"{name} keys"], self._ends[name])
                arrays.update(zip(names, found, strict=True))
        self._cache.put(self._key, arrays, report)

    def look_up(self, name: str, keys: identity.Keys) -> tuple[Index, Known]:
        """Where in what an earlier bake kept by this ``name`` places with these ``keys`` stand
        (M,), and which of them do."""
        old = self.old.get(f"{name} keys", keys[:0])
        if not len(old):
            return np.zeros(len(keys), np.int64), np.zeros(len(keys), bool)
        rows = np.minimum(np.searchsorted(old, keys), len(old) - 1)
        return rows, np.asarray(old[rows] == keys)

    def _recall(self, name: str, keys: identity.Keys, width: int) -> tuple[Bits, Known]:
        """What is known by this ``name`` of places with these ``keys``, and of which."""
        rows, known = self.look_up(name, keys)
        bits = np.zeros((len(keys), width), np.uint8)
        if known.any():
            bits[known] = self.old[f"{name} bits"][rows[known]]
        if self.has_room_for(width * int((~known).sum())):
            self._new.setdefault(name, []).append((keys, bits, known))
        return bits, known


class RayEnds:
    """Where the rays of places end, the entries that they meet, place by place: of those ``known``
    (U,) of the places what an earlier bake kept, to which what is found of the others is added."""

    def __init__(self, tape: PlaceTape, name: str, keys: identity.Keys) -> None:
        self._tape, self._keys = tape, keys
        self._rows, known = tape.look_up(name, keys)
        self._name = name
        self.known = np.flatnonzero(known)
        self.kept: list[tuple[identity.Keys, Index, Ends]] = []

    def of(self, numbers: Index) -> tuple[Index, Ends]:
        """How many rays of each of the known places ``numbers`` (P,) meet something, and where
        these end, one place after the other."""
        counts, starts, ends = (self._tape.old[f"{self._name} {what}"] for what in OF_ENDS)
        rows = self._rows[numbers]
        its = counts[rows].astype(np.int64)
        before = np.repeat(starts[rows] - (np.cumsum(its) - its), its)
        return its, ends[before + np.arange(len(before))]

    def keep(self, numbers: Index, counts: Index, ends: Ends) -> None:
        """Keep what was found of places ``numbers`` (P,), as it comes out of ``of``.  Safe to call
        from several threads."""
        if self._tape.has_room_for(ends.nbytes):
            self.kept.append((self._keys[numbers], counts, ends))


def _unknown(some: list[tuple[identity.Keys, Bits, Known]]) -> list[npt.NDArray[Any]]:
    """Keys and bits of those that were not known."""
    keys = [keys[~known] for keys, _, known in some]
    return [np.concatenate(keys), np.concatenate([bits[~known] for _, bits, known in some])]


def _joined(
    old: Sequence[npt.NDArray[Any]], before: identity.Keys, keys: identity.Keys, new: list[RayEnds]
) -> list[npt.NDArray[Any]]:
    """Counts and starts (M,) of places with these ``keys``, and all ends: the ``old`` ones of the
    places with keys ``before``, or none, and behind them the ``new`` ones."""
    counts, starts = np.zeros(len(keys), np.uint32), np.zeros(len(keys), np.int64)
    ends, length = [np.zeros(0, np.uint16)], 0
    if old:
        rows = np.searchsorted(keys, before)
        counts[rows], starts[rows], length = old[0], old[1], len(old[2])
        ends.append(old[2])
    for its_keys, its_counts, its_ends in (piece for some in new for piece in some.kept):
        rows = np.searchsorted(keys, its_keys)
        counts[rows], starts[rows] = its_counts, length + np.cumsum(its_counts) - its_counts
        ends.append(its_ends)
        length += len(its_ends)
    return [counts, starts, np.concatenate(ends)]
