"""The fewest bytes that hold a bake within a tolerance."""

from collections.abc import Iterator
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from . import pca

CLUSTERS = 1, 8, 64, 256
FULL = 128  # points a cluster has at least, on average
TRIED = 4096  # points on which a book is looked at before all are encoded
MARGIN = 1.1  # how much worse it may look there
STEP = 4  # numbers of an attribute; a point takes all of some, the cluster's is one of them
CODE, TEXT = 2, 9  # bytes a number of a point; of the book, as JSON has it

Float = npt.NDArray[np.float64]
Floats = npt.NDArray[np.float32]


@dataclass(frozen=True)
class Part:
    """A mesh: ``values`` (P, F) of its points, the ``importance`` (F,) of each float and the
    ``radiance`` (F, 3) that it adds under the baked light."""

    values: Floats
    importance: Float
    radiance: Float


@dataclass(frozen=True)
class Tried:
    """A way of coding a part: its ``bytes`` and its relative ``error``, both RMS, of which the
    larger counts: under the baked light, and over all turns of it; ``largest`` is under the baked
    light, at one point."""

    clusters: int
    weights: int
    bytes: int
    error: float
    largest: float


def chosen(part: Part, tolerance: float, seed: int) -> tuple[pca.Codes | None, dict[str, Any]]:
    """The smallest code of ``part`` within ``tolerance``, None where 16 bits a float take no more;
    and a report: what was ``chosen``, and what was ``tried`` on the way, smaller ones first."""
    tried: list[Tried] = []
    rng = np.random.default_rng(seed)
    count = min(TRIED, len(part.values))
    some = np.sort(rng.choice(len(part.values), count, replace=False))
    sample = Part(part.values[some], part.importance, part.radiance)
    for clusters, weights in _ways(part):
        book = pca.fitted(part.values, part.importance, clusters, weights, seed)
        few = pca.encoded(sample.values, part.importance, book, refit=False)
        seen = _measured(sample, few.decoded(), clusters, weights, _bytes(part, clusters, weights))
        if seen.error > MARGIN * tolerance:
            tried.append(seen)
            continue
        codes = pca.encoded(part.values, part.importance, book)
        size = _bytes(part, len(codes.means), weights)
        found = _measured(part, codes.decoded(), len(codes.means), weights, size)
        tried.append(found)
        if found.error <= tolerance:
            return codes, {"chosen": asdict(found), "tried": [asdict(one) for one in tried]}
    return None, {"chosen": None, "tried": [asdict(one) for one in tried]}


def _ways(part: Part) -> Iterator[tuple[int, int]]:
    """Clusters and weights, by the bytes that they take, below those of 16 bits a float."""
    points, floats = part.values.shape
    counts = [k for k in CLUSTERS if k == 1 or k * FULL <= points]
    ways = [(k, width - 1) for k in counts for width in range(STEP, floats + 1, STEP)]
    plain = CODE * points * -(-floats // STEP) * STEP
    sized = sorted((_bytes(part, *way), *way) for way in ways)
    return ((clusters, weights) for size, clusters, weights in sized if size < plain)


def _bytes(part: Part, clusters: int, weights: int) -> int:
    points, floats = map(int, part.values.shape)
    return CODE * points * (1 + weights) + TEXT * clusters * (1 + weights) * floats


def _measured(part: Part, decoded: Floats, clusters: int, weights: int, size: int) -> Tried:
    difference = (decoded - part.values).astype(np.float64)
    light = part.values @ part.radiance
    rms = float(np.sqrt(np.square(light).mean())) or 1.0
    off = difference @ part.radiance
    turned = np.sqrt(np.square(difference * part.importance).sum(axis=1).mean())
    error = max(float(np.sqrt(np.square(off).mean())), float(turned)) / rms
    return Tried(clusters, weights, size, error, float(np.abs(off).max(initial=0)) / rms)
