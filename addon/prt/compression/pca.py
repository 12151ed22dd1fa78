"""Clustered principal components of what points hold (Sloan, Hall, Hart and Snyder 2003).

Points are parted into clusters; each cluster has a mean and a few directions, and a point keeps the
number of its cluster and a weight for each direction.  What leaves the surface is linear in all of
it, so a reader multiplies mean and directions with the light once, and not each point.
"""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

SWEEPS = 8  # of assignment and fit; what later ones gain is below a hundredth
SAMPLE = 4096, 64  # points that clusters are sought among, at least; and for each of them
CHUNK = 1 << 12  # points whose distances are worked out at a time
LARGEST = 32767  # of a normalized SHORT, which stands for 1

Float = npt.NDArray[np.float64]
Floats = npt.NDArray[np.float32]
Rows = npt.NDArray[np.float64] | npt.NDArray[np.float32]
Index = npt.NDArray[np.int64]


@dataclass(frozen=True)
class Codes:
    """P points as ``means[c] + Σ_j weights_j directions[c, j]``, c being ``clusters`` (P,):
    ``means`` (K, F), ``directions`` (K, N, F), ``weights`` (P, N) from -1 to 1, rounded as
    normalized SHORT holds them."""

    clusters: Index
    weights: Floats
    means: Floats
    directions: Floats

    def decoded(self) -> Floats:
        """What the points hold, (P, F)."""
        values: Floats = self.means[self.clusters].copy()
        for j in range(self.weights.shape[1]):
            values += self.weights[:, j, None] * self.directions[self.clusters, j]
        return values


def encoded(values: Floats, importance: Float, book: "Book", *, refit: bool = True) -> Codes:
    """``values`` (P, F) in the clusters of ``book``, whose bases are fitted to all of them where
    ``refit`` says so.  ``importance`` (F,) says what an error of each float costs; those without
    any are kept as their mean."""
    scaled = values * importance
    found = _nearest(scaled, book)
    if refit:
        found = np.unique(found, return_inverse=True)[1]
        book = _book(scaled, found, book.bases.shape[1])
    coefficients = _coefficients(scaled, found, book)
    reach = np.zeros(book.bases.shape[:2])
    np.maximum.at(reach, found, np.abs(coefficients))
    steps = np.where(reach > 0, reach, 1)
    shares = np.rint(LARGEST * coefficients / steps[found]) / LARGEST
    back = np.divide(1, importance, out=np.zeros_like(importance), where=importance > 0)
    centres = np.where(importance > 0, book.means * back, values.mean(axis=0, dtype=float))
    directions = book.bases * reach[:, :, None] * back
    narrow = [np.asarray(array, np.float32) for array in (shares, centres, directions)]
    return Codes(found, *narrow)


@dataclass(frozen=True)
class Book:
    """Clusters of points that are scaled by their importance: ``means`` (K, F) and the ``bases``
    (K, N, F), orthonormal or 0."""

    means: Float
    bases: Float


def fitted(values: Floats, importance: Float, clusters: int, weights: int, seed: int) -> Book:
    """At most so many ``clusters`` of so many ``weights`` for a sample of ``values`` (P, F)."""
    rng = np.random.default_rng(seed)
    count = min(len(values), max(SAMPLE[0], SAMPLE[1] * clusters))
    some = values[np.sort(rng.choice(len(values), count, replace=False))] * importance
    centres = _spread(some.astype(np.float64), clusters, rng)
    book = Book(centres, np.zeros((len(centres), 0, values.shape[1])))
    for _ in range(SWEEPS if len(centres) > 1 else 1):
        found = np.unique(_nearest(some, book), return_inverse=True)[1]
        book = _book(some, found, weights)
    return book


def _spread(points: Float, count: int, rng: np.random.Generator) -> Float:
    """Up to ``count`` of ``points``, far from each other: k-means++ (Arthur and Vassilvitskii)."""
    chosen = [points[rng.integers(len(points))]]
    distances = np.square(points - chosen[0]).sum(axis=1)
    while len(chosen) < count and distances.sum() > 0:
        pick = rng.choice(len(points), p=distances / distances.sum())
        chosen.append(points[pick])
        distances = np.minimum(distances, np.square(points - chosen[-1]).sum(axis=1))
    return np.array(chosen)


def _book(scaled: Rows, found: Index, weights: int) -> Book:
    """The mean and the directions of largest variance of each cluster, ``found`` (P,)."""
    count, width = int(found.max(initial=0)) + 1, scaled.shape[1]
    order = np.argsort(found, kind="stable")
    starts = np.searchsorted(found[order], np.arange(count + 1))
    means, bases = np.zeros((count, width)), np.zeros((count, weights, width))
    kept = min(weights, width)
    for k in range(count):
        points = scaled[order[starts[k] : starts[k + 1]]].astype(np.float64)
        means[k] = points.mean(axis=0)
        rest = points - means[k]
        variances, directions = np.linalg.eigh(rest.T @ rest)
        bases[k, :kept] = directions.T[::-1][:kept] * (variances[::-1][:kept, None] > 0)
    return Book(means, bases)


def _nearest(scaled: Rows, book: Book) -> Index:
    """The cluster (P,) that leaves the least of each point: ``|x - m|² - |B (x - m)|²``, without
    the ``|x|²`` that all have in common."""
    count, weights, width = book.bases.shape
    along = book.bases.reshape(count * weights, width)
    offsets = np.einsum("knf,kf->kn", book.bases, book.means).ravel()
    lengths = np.square(book.means).sum(axis=1)
    found = np.empty(len(scaled), np.int64)
    for start in range(0, len(scaled), CHUNK):
        points = scaled[start : start + CHUNK].astype(np.float64)
        left = lengths - 2 * points @ book.means.T
        kept = np.square(points @ along.T - offsets)
        left -= kept.reshape(len(points), count, weights).sum(axis=2)
        found[start : start + CHUNK] = left.argmin(axis=1)
    return found


def _coefficients(scaled: Rows, found: Index, book: Book) -> Float:
    """How far each point goes along the directions of its cluster, (P, N)."""
    result = np.empty((len(scaled), book.bases.shape[1]))
    for start in range(0, len(scaled), CHUNK):
        here = found[start : start + CHUNK]
        rest = scaled[start : start + CHUNK] - book.means[here]
        result[start : start + CHUNK] = np.einsum("pf,pnf->pn", rest, book.bases[here])
    return result
