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
            drawn = light.drawn(batch.normals, self._picks(batch.numbers, k))
            visible = _sees(batch, drawn, occlusion, counts)
            its = batch.normals, batch.cosines, batch.directions, batch.visible
            found.append(light.exit_radiance(*its, drawn, visible))
        if self._peaks is not None and self._peaks.peaks:
            drawn = self._peaks.drawn(batch.normals, self._picks(batch.numbers, len(self._lights)))
            visible = _sees(batch, drawn, occlusion, counts)
            found.append(self._peaks.shadowed_cosine(batch.normals, drawn, visible))
        return np.concatenate(found, axis=1), counts

    def _picks(self, numbers: Index, k: int) -> Index:
        """A number of no pattern for every point."""
        mixed = (numbers.astype(np.uint64) + np.uint64(1 + 7919 * k + self._seed)) * np.uint64(MIX)
        return (mixed >> np.uint64(33)).astype(np.int64)


def _sees(batch: Batch, drawn: Drawn, occlusion: Occlusion, counts: Counts) -> Array:
    """Which of the rays ``drawn`` (R,) for the batch's points reach the sky, 1 or 0."""
    point, directions = drawn.point, drawn.directions
    visible = np.ones(len(point), np.float32)
    traced: Index | slice = slice(None)
    if batch.open_above <= 1:
        traced = np.flatnonzero(drawn.ray_cosines <= batch.open_above)
        counts[NOTHING_ABOVE] += len(point) - len(traced)
        point, directions = point.take(traced), directions.take(traced, axis=0)
    if len(point):
        origins = batch.origins.take(point, axis=0)
        visible[traced] = as_visible(occlusion.sky_mask(origins, directions))
        again = np.flatnonzero(batch.doubtful.take(drawn.point) & (visible > 0))
        starts = batch.origins.take(drawn.point.take(again), axis=0)
        visible[again] = confirmed(occlusion, starts, drawn.directions.take(again, axis=0))
        counts[MAP_RAYS] += len(point) + CASTS * len(again)
    return visible
