"""What is found beside the transfer, from its rays and some of the map: the exact light."""

from collections import Counter
from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from ..tracing.confirm import CASTS, confirmed
from ..tracing.gathering import Batch
from ..tracing.rays import Occlusion, as_visible
from ..tracing.transfer import MAP_RAYS, NOTHING_ABOVE, Counts
from .exact import ExactLight
from .peaks import PeakRays

Array = npt.NDArray[np.float32]
Index = npt.NDArray[np.int64]

MIX = 0x9E3779B97F4A7C15  # 2^64 over the golden ratio: Knuth's multiplicative hash


class LightGather:
    """Exit radiance of white surfaces under ``lights``, three columns each; then the shadowed
    cosines of ``peaks``, a column each."""

    def __init__(self, lights: Sequence[ExactLight], peaks: PeakRays | None, seed: int) -> None:
        self._lights, self._peaks, self._seed = lights, peaks, seed

    @property
    def columns(self) -> int:
        """Three for each light and one for each peak."""
        return 3 * len(self._lights) + (self._peaks.peaks if self._peaks else 0)

    def __call__(self, batch: Batch, occlusion: Occlusion) -> tuple[Array, Counts]:
        """The columns of the batch's points, and the rays of the map that they took."""
        counts: Counts = Counter()
        found = []
        for k, light in enumerate(self._lights):
            picks = self._picks(batch.numbers, k)
            point, directions = light.candidates(batch.normals, picks)
            visible = _sees(batch, point, directions, occlusion, counts)
            found.append(
                light.exit_radiance(
                    batch.normals,
                    batch.cosines,
                    batch.directions,
                    batch.visible,
                    point,
                    visible,
                    picks,
                )
            )
        if self._peaks is not None and self._peaks.peaks:
            picks = self._picks(batch.numbers, len(self._lights))
            point, directions = self._peaks.candidates(batch.normals, picks)
            visible = _sees(batch, point, directions, occlusion, counts)
            found.append(self._peaks.shadowed_cosine(batch.normals, picks, visible))
        return np.concatenate(found, axis=1), counts

    def _picks(self, numbers: Index, k: int) -> Index:
        """A number of no pattern for every point."""
        mixed = (numbers.astype(np.uint64) + np.uint64(1 + 7919 * k + self._seed)) * np.uint64(MIX)
        return (mixed >> np.uint64(33)).astype(np.int64)


def _sees(
    batch: Batch,
    point: npt.NDArray[np.int32],
    directions: Array,
    occlusion: Occlusion,
    counts: Counts,
) -> Array:
    """Which of ``directions`` (R, 3) from the batch's points ``point`` (R,) reach the sky, 1 or
    0."""
    visible = np.ones(len(point), np.float32)
    traced = np.arange(len(point))
    if batch.open_above <= 1:
        cosine = np.einsum("rc,rc->r", directions, batch.normals[point])
        traced = np.flatnonzero(cosine <= batch.open_above)
        counts[NOTHING_ABOVE] += len(point) - len(traced)
    origins = batch.origins[point[traced]]
    if len(origins):
        visible[traced] = as_visible(occlusion.sky_mask(origins, directions[traced]))
        again = np.flatnonzero(batch.doubtful[point] & (visible > 0))
        visible[again] = confirmed(occlusion, batch.origins[point[again]], directions[again])
        counts[MAP_RAYS] += len(origins) + CASTS * len(again)
    return visible
