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
from .map_sampler import Drawn
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
            drawn = light.drawn(batch.normals, picks, batch.open_above)
            visible = _sees(batch, drawn, occlusion, counts)
            its = batch.normals, batch.cosines, batch.directions, batch.visible
            found.append(light.exit_radiance(*its, drawn, visible))
        if self._peaks is not None and self._peaks.peaks:
            picks = self._picks(batch.numbers, len(self._lights))
            drawn = self._peaks.drawn(batch.normals, picks, batch.open_above)
            visible = _sees(batch, drawn, occlusion, counts)
            found.append(self._peaks.shadowed_cosine(batch.normals, drawn, visible))
        return np.concatenate(found, axis=1), counts

    def _picks(self, numbers: Index, k: int) -> Index:
        """A number of no pattern for every point."""
        mixed = (numbers.astype(np.uint64) + np.uint64(1 + 7919 * k + self._seed)) * np.uint64(MIX)
        return (mixed >> np.uint64(33)).astype(np.int64)


def _sees(batch: Batch, drawn: Drawn, occlusion: Occlusion, counts: Counts) -> Array:
    """Which of the rays ``drawn`` (R,) for the batch's points reach the sky, 1 or 0."""
    counts[NOTHING_ABOVE] += int(np.count_nonzero(drawn.is_open))
    if not len(drawn.point):
        return np.zeros(0, np.float32)
    origins = batch.origins.take(drawn.point, axis=0)
    visible = as_visible(occlusion.sky_mask(origins, drawn.directions))
    again = np.flatnonzero(batch.doubtful.take(drawn.point) & (visible > 0))
    starts, directions = origins.take(again, axis=0), drawn.directions.take(again, axis=0)
    visible[again] = confirmed(occlusion, starts, directions)
    counts[MAP_RAYS] += len(origins) + CASTS * len(again)
    return visible
