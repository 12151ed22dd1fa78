"""Shadowed transfer vectors: rays from points, summed against the basis.

T_i = 1/pi integral V(w) max(n.w, 0) Y_i(w) dw: dot with radiance coefficients gives the exit
radiance of a white surface, so 1/pi is inside and the surface's albedo is not.
"""

import threading
from collections import Counter, deque
from collections.abc import Generator, Iterator
from concurrent.futures import Future
from dataclasses import dataclass, replace
from functools import cache, partial
from itertools import islice
from typing import Any

import numpy as np
import numpy.typing as npt

from ..job import Settings
from ..parallel import workers
from ..surface.points import Points
from .confirm import CASTS, confirmed, doubtful
from .gathering import Batch, Gather
from .hemisphere import GROUP, RaysInWorld, Turn, frames, hemisphere_set, rays_in_world
from .horizon import Horizon
from .looking import Look, Shown, Split
from .open_rays import Alike, OpenRays, turns
from .rays import BLOCKED, Occlusion, as_visible
from .visibility import VisibilitySet

Array = npt.NDArray[np.float32]
Index = npt.NDArray[np.int64]
Bits = npt.NDArray[np.uint8]
Counts = Counter[str]

BATCH_RAYS = 32768
PARTS = 8  # of the points that are left, so that threads end together, but
PART_RAYS = 1 << 16, 1 << 18  # in a part no fewer and no more
FEWEST_PARTS = 4  # of few rays, too
LITTLE = 1 << 16  # rays: fewer are cast by the thread that asks, before others would have begun
AHEAD = 2  # pieces whose horizon is found while others are traced
MOST_GROUPS = 1024  # in a part
CLOSED = 4  # every so many-th ray is cast, where it is asked which may be blocked
FEWEST_TRACED = 64, 16  # every so many-th, at least, counts: where sums are all, and else

CAST = "cast"
MAP_RAYS = "cast towards the map's light"
NOTHING_ABOVE = "nothing stands above the horizon"
SEES_NOTHING = "the first rays were all blocked"
KNOWN = "known from another bake"


@dataclass(frozen=True)
class Shortcuts:
    """What a trace need not find out with rays.

    ``horizon`` knows directions that nothing can block.  Where ``pilot`` is 2 or more, every
    ``pilot``-th ray of a point is traced first, and a point where all of them are blocked stops.
    ``bits`` (P, N / 8) is the visibility of every ray: read of points that are ``known`` (P,), else
    filled in.
    ``look`` is shown one of every ``shown`` rays that are traced, and needs a ``pilot`` of 0.
    """

    horizon: Horizon | None = None
    pilot: int = 0
    bits: Bits | None = None
    known: npt.NDArray[np.bool_] | None = None
    look: Look | None = None
    shown: int = 1


@dataclass(frozen=True)
class _Few:
    """Points whose rays are cast together: their ``numbers`` and ``origins``, the ``matrices`` of
    their frames, and which of their rays are known to be ``open``."""

    numbers: Index
    origins: Array
    matrices: Array
    open: Alike

    def only(self, some: Index) -> "_Few":
        """Those that are ``some`` (M,) of them."""
        its = self.numbers[some], self.origins[some], self.matrices[some]
        return _Few(*its, self.open)


class Tracer:
    """Fills transfer vectors of parts of the points.

    For a batch of points two products make the rays, one Embree call finds their visibility, and
    one product sums the local coefficients; a part of many batches is turned to world axes at once.
    """

    def __init__(
        self,
        points: Points,
        occlusion: Occlusion,
        settings: Settings,
        shortcuts: Shortcuts,
        gather: Gather | None,
        *,
        visibility_order: int = 0,
        azimuth: npt.NDArray[np.float64] | None = None,
    ) -> None:
        self.points, self.rays, self._occlusion = points, settings.rays, occlusion
        self.is_little = len(points.origins) * settings.rays < LITTLE
        if azimuth is None:
            random = np.random.default_rng([settings.seed, settings.rays])
            azimuth = random.random(len(points.origins)) * (2 * np.pi)
        self._azimuth = azimuth
        self._azimuth_turns = turns(self._azimuth)
        hemisphere = hemisphere_set(settings.rays, settings.order)
        self._local = hemisphere.directions
        self._direction_turns = turns(np.arctan2(self._local[:, 1], self._local[:, 0]))
        self._cosines = np.ascontiguousarray(hemisphere.directions[:, 2])
        self._in_world = rays_in_world(settings.rays)
        self._weights = hemisphere.weights
        sums = np.cumsum(np.insert(hemisphere.weights, 0, 0, axis=0), axis=0, dtype=np.float64)
        self._sums_of_first = sums.astype(np.float32)
        self._turn = Turn(settings.order)
        self._seen_sh = VisibilitySet(settings.rays, visibility_order) if visibility_order else None
        self._shortcuts, self._gather = shortcuts, gather
        self.open_rays = OpenRays(shortcuts.horizon, points, settings.rays)
        step = max(1, shortcuts.shown if shortcuts.look else shortcuts.pilot)
        first = step // 2 if shortcuts.look else 0
        chosen = np.arange(self.rays) % step == first  # to be looked at, or cast before the others
        self._split = cache(partial(Split, chosen, self._local))
        if step > 1 or shortcuts.look:
            self._chosen_in_world = RaysInWorld(hemisphere.directions[chosen])
            self._others_in_world = RaysInWorld(hemisphere.directions[~chosen])
        wants_each = (gather, shortcuts.bits, shortcuts.look, self._seen_sh)  # ray of a point
        self._sums_only = all(want is None for want in wants_each)
        self._buffers = threading.local()
        self._left = len(points.origins)  # in no part yet

    def parts(self, found: list[Alike]) -> Iterator[Alike]:
        """Of what was ``found`` of a piece, some groups of points each, neighbours where they can
        be; fewer and fewer towards the end."""
        low, high = PART_RAYS
        if not self.is_little:
            low = min(low, len(self.points.origins) * self.rays // FEWEST_PARTS)
        for alike in found:
            groups = alike.groups
            while len(groups):
                rays = max(low, min(self._left * self.rays // PARTS, high))
                size = max(4, min(MOST_GROUPS, rays // (GROUP * self._traced(alike))) // 4 * 4)
                yield replace(alike, groups=groups[:size])
                groups = groups[size:]
                self._left -= GROUP * size

    def _traced(self, alike: Alike) -> int:
        """About how many rays of each of these points are traced, so that parts and batches take
        about as long each."""
        left = self.rays - alike.first
        fewest = self.rays // FEWEST_TRACED[not self._sums_only]
        return max(1, left // CLOSED if alike.pays else left, fewest)

    def trace(self, part: Alike, out: Array) -> Counts:
        """Transfer, what is gathered, and visibility of the points of ``part`` into ``out``; the
        rays."""
        groups, transfer = len(part.groups), self._weights.shape[1]
        numbers = (part.groups[:, None] * GROUP + np.arange(GROUP)).reshape(-1)
        numbers = numbers[numbers < len(self.points.origins)]  # the last group may not be full
        local = frames(self.points.normals[numbers], self._azimuth[numbers])
        matrices, origins = local.matrices(), self.points.origins[numbers]
        columns = transfer + (self._seen_sh.columns if self._seen_sh else 0)
        sums = np.empty((groups * GROUP, columns), np.float32)
        counts: Counts = Counter()
        size = GROUP * max(1, BATCH_RAYS // (GROUP * self._traced(part)))
        for start in range(0, len(numbers), size):
            few = slice(start, start + size)
            batch = _Few(numbers[few], origins[few], matrices[few], part)
            counts += self._trace_batch(batch, sums[few], out)
        out[numbers, :transfer] = self._turn(local, sums[: len(numbers), :transfer])
        if self._seen_sh is not None:
            seen = self._seen_sh.in_world(local, sums[: len(numbers), transfer:])
            out[numbers, out.shape[1] - self._seen_sh.columns :] = seen
        return counts

    def _trace_batch(self, batch: _Few, sums: Array, out: Array) -> Counts:
        """Local coefficients of whole groups into ``sums``, of their transfer and of their
        visibility; what is gathered into ``out``."""
        first = batch.open.first if self._sums_only else 0  # their sums are known
        count, left = len(batch.numbers), self.rays - first
        visible, columns = self._array("visible", (len(sums), left)), self._weights.shape[1]
        visible[count:] = 0
        if first:
            cast = self._see_others(batch, visible[:count])
            counts = Counter({CAST: cast, NOTHING_ABOVE: count * self.rays - cast})
        else:
            counts = self._see(batch, visible[:count])
        products = visible.reshape(len(sums) // GROUP, GROUP, left) @ self._weights[first:]
        sums[:, :columns] = products.reshape(len(sums), columns)
        sums[:, :columns] += self._sums_of_first[first]
        if self._seen_sh is not None:
            sums[:, columns:] = self._seen_sh.sums(visible)
        if self._gather is not None:
            values, more = self._gather(self._seen(batch, visible[:count]), self._occlusion)
            out[batch.numbers, columns : columns + values.shape[1]] = values
            counts += more
        return counts

    def _seen(self, batch: _Few, visible: Array) -> Batch:
        """What a Gather is told."""
        count, first = len(visible), batch.open.first
        directions = self._array("gathered", (count, 3 * self.rays)).reshape(count, 3, self.rays)
        self._in_world.planes(batch.matrices, directions)
        return Batch(
            batch.numbers,
            batch.origins,
            self.points.normals[batch.numbers],
            directions,
            self._cosines,
            visible,
            float(np.sqrt(1 - first / self.rays)) if first else 2.0,
            doubtful(visible, self._occlusion),
        )

    def _see(self, batch: _Few, visible: Array) -> Counts:
        """Fill in which rays of the points reach the sky, 1 or 0; the rays cast and skipped."""
        bits, known = self._shortcuts.bits, self._shortcuts.known
        if bits is None:
            return self._cast(batch, visible)
        mine = np.zeros(len(batch.numbers), bool) if known is None else known[batch.numbers]
        if not mine.any():
            counts = self._cast(batch, visible)
            bits[batch.numbers] = np.packbits(visible != 0, axis=1)
            return counts
        left = np.flatnonzero(~mine)
        counts = Counter({KNOWN: (len(batch.numbers) - len(left)) * self.rays})
        if len(left):
            found = np.empty((len(left), self.rays), np.float32)
            counts += self._cast(batch.only(left), found)
            bits[batch.numbers[left]] = np.packbits(found != 0, axis=1)
        visible[:] = np.unpackbits(bits[batch.numbers], axis=1, count=self.rays)
        return counts

    def _cast(self, batch: _Few, visible: Array) -> Counts:
        """As ``_see``, of points of which nothing is known."""
        first = batch.open.first
        if first or self._shortcuts.pilot < 2:
            visible[:, :first] = 1
            cast = self._see_others(batch, visible[:, first:])
            counts = Counter({CAST: cast, NOTHING_ABOVE: visible.size - cast})
        else:
            counts = self._see_first(batch, visible)
        counts[CAST] += self._confirm(batch, visible)
        return counts

    def _see_others(self, batch: _Few, visible: Array) -> int:
        """Those after the first that need no tracing, ``visible`` (P, N - first); rays cast."""
        first = batch.open.first
        if first == self.rays:
            return 0
        if self._shortcuts.look is not None:
            self._look(self._shortcuts.look, batch, visible)
            return visible.size
        if not batch.open.pays:
            visible[:] = self._sky(self._in_world, batch.origins, batch.matrices, first)
            return visible.size
        azimuth = self._azimuth_turns[batch.numbers]
        closed = self.open_rays.may_be_blocked(batch.numbers, self._direction_turns, azimuth, first)
        rest = np.flatnonzero(closed)
        point = np.repeat(np.arange(len(closed)), np.count_nonzero(closed, axis=1))
        directions = self._array("directions", (closed.size, 3))
        self._in_world.directions(batch.matrices, directions, first)
        mask = self._occlusion.sky_mask(batch.origins.take(point, 0), directions.take(rest, 0))
        found = self._array("found", closed.shape)
        found.fill(1)
        found.reshape(-1)[rest.take(np.flatnonzero(mask == BLOCKED))] = 0
        visible[:] = found
        return len(rest)

    def _see_first(self, batch: _Few, visible: Array) -> Counts:
        """The first rays, and the others of the points where one of them is clear."""
        step = self._shortcuts.pilot
        clear = self._sky(self._chosen_in_world, batch.origins, batch.matrices)
        visible[:, ::step] = clear
        is_alive = clear.any(axis=1)
        alive = np.flatnonzero(is_alive)
        others = self._sky(self._others_in_world, batch.origins[alive], batch.matrices[alive])
        visible[~is_alive] = 0
        for k in range(1, step):
            visible[alive, k::step] = others[:, k - 1 :: step - 1]
        stopped = (len(batch.numbers) - len(alive)) * others.shape[1]
        return Counter({CAST: clear.size + others.size, SEES_NOTHING: stopped})

    def _confirm(self, batch: _Few, visible: Array) -> int:
        """Cast the clear rays again where a single one would show; how many."""
        points = np.flatnonzero(doubtful(visible, self._occlusion))
        if not len(points):
            return 0
        row, ray = np.nonzero(visible[points])
        row = points[row]
        x, y, z = self._local[ray].T[:, :, None]
        matrices = batch.matrices[row]
        directions = matrices[:, :, 0] * x + matrices[:, :, 1] * y + matrices[:, :, 2] * z
        visible[row, ray] = confirmed(self._occlusion, batch.origins[row], directions)
        return CASTS * len(row)

    def _look(self, look: Look, batch: _Few, visible: Array) -> None:
        """Those after the first that need no tracing, ``visible`` (P, N - first), of which some are
        looked at."""
        origins, matrices, split = batch.origins, batch.matrices, self._split(batch.open.first)
        count = len(batch.numbers)
        others = np.zeros((count, 1, 4), np.float32)
        if len(split.ones_and_local):
            clear = self._sky(self._others_in_world, origins, matrices, split.others_before)
            visible[:, split.others] = clear
            np.matmul((1 - clear)[:, None], split.ones_and_local, out=others)
        if not len(split.rays):
            return
        some = self._rays(self._chosen_in_world, origins, matrices, split.mine_before)
        mask = look(Shown(batch.numbers, split.rays, split.local, *some, others[:, 0]))
        visible[:, split.mine] = -mask.reshape(count, len(split.rays))

    def _sky(self, in_world: RaysInWorld, origins: Array, matrices: Array, first: int = 0) -> Array:
        """1 where the rays (P, N) of P points, but the ``first`` ones, reach the sky, else 0."""
        mask = self._occlusion.sky_mask(*self._rays(in_world, origins, matrices, first))
        return as_visible(mask).reshape(len(origins), in_world.count - first)

    def _rays(
        self, in_world: RaysInWorld, origins: Array, matrices: Array, first: int
    ) -> tuple[Array, Array]:
        """Where the rays (P, N) of P points, but the ``first`` ones, start and go, in a row."""
        count = len(origins) * (in_world.count - first)
        starts, directions = (self._array(n, (count, 3)) for n in ("origins", "directions"))
        in_world.origins(origins, starts, first)
        in_world.directions(matrices, directions, first)
        return starts, directions

    def _array(self, name: str, shape: tuple[int, int]) -> Array:
        """An array of this thread, its content whatever was in it."""
        size = shape[0] * shape[1]
        kept: Array | None = getattr(self._buffers, name, None)
        if kept is None or kept.size < size:
            kept = np.zeros(size, np.float32)
            setattr(self._buffers, name, kept)
        return kept[:size].reshape(shape)


def trace_all(
    points: Points,
    occlusion: Occlusion,
    settings: Settings,
    out: Array,
    *,
    shortcuts: Shortcuts = Shortcuts(),
    gather: Gather | None = None,
    visibility_order: int = 0,
    azimuth: npt.NDArray[np.float64] | None = None,
) -> Generator[int, None, Counts]:
    """Fill ``out`` (P, n² + gathered columns + visibility_order²) and yield the rays cast so far;
    ``close()`` stops it.  Rays are turned about the normals by ``azimuth`` (P,) in radians, by
    default a random one.

    The value is the rays cast and skipped, by reason.  The same bits for any number of threads and
    any size of the batches.
    """
    tracer = Tracer(
        points,
        occlusion,
        settings,
        shortcuts,
        gather,
        visibility_order=visibility_order,
        azimuth=azimuth,
    )
    counts: Counts = Counter()
    pool = workers(settings.threads, is_little=tracer.is_little)
    pieces = iter(tracer.open_rays.pieces())
    at_work = deque[Future[Any]]()

    def find_more(count: int) -> None:
        at_work.extend(pool.submit(tracer.open_rays.find, p) for p in islice(pieces, count))

    try:
        find_more(AHEAD)
        while at_work:
            done = at_work.popleft().result()  # the others are taken up in this order
            if isinstance(done, Counter):
                counts += done
            else:
                at_work.extend(pool.submit(tracer.trace, p, out) for p in tracer.parts(done))
                find_more(1)
            yield counts[CAST] + counts[MAP_RAYS]
    finally:
        pool.shutdown(wait=True, cancel_futures=True)
    return counts


def relative_rms(values: npt.ArrayLike, reference: npt.ArrayLike) -> float:
    """RMS of the difference over the RMS of the reference; 0 where both are 0, or empty."""
    expected = np.asarray(reference, np.float64)
    if not expected.size:
        return 0.0
    difference = float(np.mean((np.asarray(values) - expected) ** 2))
    size = float(np.mean(expected**2))
    return (difference / size) ** 0.5 if size > 0 else float(difference > 0)
