"""What leaves the entries that rays end at: light that arrived there, times the albedo."""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float32]
Index = npt.NDArray[np.int64]
Entry = npt.NDArray[np.int32]

COLOURED = 1 / 255  # the largest difference of two channels of an albedo that is still grey
DENSE = 16  # numbers a key up to which a table of all numbers is faster than sorting
ALBEDO_STEPS = 1023  # albedos closer than one step are one


def channels_of(albedo: Array) -> int:
    """3 where any of ``albedo`` (F, 3, 3) is coloured, else 1."""
    r, g, b = albedo[..., 0], albedo[..., 1], albedo[..., 2]  # a reduction over three is slow
    spread = max(float(np.abs(x - y).max(initial=0)) for x, y in ((r, g), (g, b), (b, r)))
    return 3 if spread > COLOURED else 1


@dataclass(frozen=True)
class Sources:
    """Pairs of a node, which is a place whose light is known, and an albedo there: ``nodes`` (S,),
    ``albedo`` (S, 1 or 3).  ``of_entries`` (2 count + 1,) is the source of each entry, S where it
    is black; the last one stands for the sky."""

    nodes: Index
    albedo: Array
    of_entries: Entry

    @classmethod
    def of(cls, nodes: Entry, used: Index, albedo: Array) -> "Sources":
        """Of entries whose nodes are ``nodes`` (2 count,), -1 for none; those ``used`` (U,) have
        ``albedo`` (U, channels)."""
        has = nodes[used] >= 0
        used, albedo = used[has], albedo[has]
        steps = np.rint(albedo * ALBEDO_STEPS).astype(np.int64)
        colours = _numbered(steps @ (ALBEDO_STEPS + 1) ** np.arange(albedo.shape[1]))[1]
        first, number = _numbered(
            nodes[used].astype(np.int64) * (colours.max(initial=0) + 1) + colours
        )
        of_entries = np.full(len(nodes) + 1, len(first), np.int32)
        of_entries[used] = number
        return cls(nodes[used[first]].astype(np.int64), albedo[first], of_entries)

    def table(self, values: Array, channel: Index) -> Array:
        """What leaves each source (S + 1, K), and nothing from the last row, where ``values``
        (nodes, K) arrive: column k is of the colour channel ``channel[k]``."""
        table = np.zeros((len(self.nodes) + 1, values.shape[1]), np.float32)
        np.take(values, self.nodes, axis=0, out=table[:-1], mode="clip")
        table[:-1] *= self.albedo[:, np.minimum(channel, self.albedo.shape[1] - 1)]
        return table


def _numbered(keys: Index) -> tuple[Index, Index]:
    """Where each different one of ``keys`` (E,), not negative, stands, in the order of the keys,
    and which of them each is (E,)."""
    most = int(keys.max(initial=-1)) + 1
    if most > DENSE * len(keys):
        _, first, number = np.unique(keys, return_index=True, return_inverse=True)
        return first, number.reshape(-1)
    place = np.full(most, -1, np.int64)
    place[keys] = np.arange(len(keys))
    there = place >= 0
    return place[there], (np.cumsum(there) - 1)[keys]
