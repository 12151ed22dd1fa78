"""One receiver: what is known of it already, how many rays it takes, its bake and the report."""

from abc import ABC, abstractmethod
from collections import Counter
from collections.abc import Generator, Sequence
from dataclasses import asdict, dataclass, replace
from functools import cached_property
from threading import Lock
from typing import TYPE_CHECKING, Any, Generic, TypeVar

import numpy as np
import numpy.typing as npt

from .cache import Cache, Keys
from .cache import Entry as Kept
from .errors import BakeError
from .job import Job, Progress, Receiver
from .light.world import World
from .meter import Meter
from .place_tape import PlaceTape
from .results import RESULT_ARRAYS, ReceiverResult
from .surface.points import Points, distinct_points
from .tape import Remembered, Tape
from .tracing.flats import Parts, fewer
from .tracing.rays import Geometry, occlusion
from .tracing.surroundings import Surroundings
from .tracing.tolerance import FALL, Effort, effort, estimate_error
from .tracing.transfer import CAST, MAP_RAYS, Counts, Shortcuts, trace_all
from .vertex.parts import may_fit
from .vertex.solver import Solved, pilot_error, solve
from .vertex.traced import Found, Traced

if TYPE_CHECKING:
    from .bounces.hits import Gathered  # and all else of it where light bounces
    from .bounces.keeper import Keeper
    from .tracing.looking import Look

Array = npt.NDArray[np.float32]
Entry = dict[str, Any]
What = TypeVar("What", bound=Found)

PILOT_RAYS = 1024  # the most that a place of a pilot takes
SAME_PLACE = "the same position and normal"
UNCHANGED = "nothing has changed since an earlier bake"


@dataclass(frozen=True)
class Far:
    """Hashes of what a ``result`` and the ``visibility`` behind it depend on out of reach, and of
    what the ``rays`` of all receivers together do."""

    result: bytes = b""
    visibility: bytes = b""
    rays: bytes = b""


class Scene:
    """What all receivers of a job share."""

    def __init__(
        self, job: Job, world: World, cache: Cache, meter: Meter, whole: "Scene | None" = None
    ) -> None:
        self.job, self.world, self.cache, self.meter = job, world, cache, meter
        self._whole = whole
        self._building = Lock()
        self._built: Geometry | None = None
        self._keys = Keys(job)
        self._occluders = Parts.of(
            job.occluder_vertices, job.occluder_triangles, job.occluder_starts
        )
        self.surroundings = Surroundings(self._occluders, lambda: self.flattened)

    @cached_property
    def flattened(self) -> Parts:
        """The occluders with each flat grid as a few large triangles, for all that need not know
        which triangle is met."""
        if self._whole is not None:
            return self._whole.flattened
        with self.meter.phase("acceleration structure"):
            return fewer(self._occluders)

    @cached_property
    def occlusion(self) -> Geometry:
        """Embree over everything, built when the first ray is cast, by the first of the threads
        that cast one."""
        if self._whole is not None:
            return self._whole.occlusion
        with self._building:
            if self._built is None:
                self._built = self._build()
            return self._built

    def _build(self) -> Geometry:
        with self.meter.phase("acceleration structure"):
            # light bounces off the very triangle that a ray meets
            met = self._occluders if self.job.bounces else self.flattened
            threads = self.job.settings.threads
            return occlusion(met.vertices, met.triangles, self._rays(), threads)

    @cached_property
    def channels(self) -> int:
        """Of the transfer: three where colours bounce."""
        if not self.job.bounces:
            return 1
        from .bounces.sources import channels_of

        return channels_of(np.asarray(self.job.occluder_albedo))

    def only(self, indices: Sequence[int]) -> "Scene":
        """The same for some of the receivers; the others are mere occluders."""
        if len(indices) == len(self.job.receivers):
            return self
        receivers = tuple(self.job.receivers[i] for i in indices)
        job = replace(self.job, receivers=receivers)
        return Scene(job, self.world, self.cache, self.meter, whole=self)

    def _rays(self) -> int:
        """About how many a bake of everything casts that may slip."""
        points = sum(len(r.normals) for r in self.job.receivers)
        return points * self.job.settings.rays if self.job.kind == "bake" else 0

    def pilot_key(self, index: int, points: Points) -> str:
        """Names what a pilot says of a receiver; "" where nothing is kept."""
        if not self.job.settings.cache:
            return ""
        return self._keys.receiver("pilot", index, self.surroundings.reachable(points), False)

    def keys(self, index: int, points: Points, far: Far | None = None) -> tuple[str, str]:
        """Names of a receiver's result and of its tape; "" for what is not kept.  ``far`` is what
        these depend on beside the occluders in reach."""
        if not self.job.settings.cache:
            return "", ""
        parts, far = self.surroundings.reachable(points), far or Far()
        result = self._keys.receiver("result", index, parts, self.world.is_exact, far.result)
        if not (self.world.is_exact or far.visibility):
            return result, ""
        return result, self._keys.receiver("visibility", index, parts, False, far.visibility)


@dataclass(frozen=True)
class Baked:
    """``result`` and what the report says of it; ``solved`` unless it was known already."""

    result: ReceiverResult
    entry: Entry
    points: Points
    solved: Found | None = None


def prepared(receiver: Receiver) -> Points:
    """The points of ``receiver``; BakeError where it has none."""
    points = distinct_points(receiver)
    if not len(points.origins):
        raise BakeError(
            f"Object {receiver.name!r} has only faces without area: use Mesh > Clean Up"
        )
    return points


def unchanged(name: str, points: Points, known: Kept) -> Baked:
    """What was kept of a receiver that is now called ``name``."""
    arrays: dict[str, Any] = {array: np.array(known.arrays[array]) for array in RESULT_ARRAYS}
    skipped = {UNCHANGED: known.report["rays"]}
    entry = {**known.report, "name": name, "rays": 0, "skipped": skipped}
    entry.update(seconds={}, mrays_per_second=0.0)
    return Baked(ReceiverResult(name, **arrays), entry, points)


def bake(scene: Scene, index: int) -> Generator[Progress, None, Baked]:
    """Bake receiver ``index`` of the scene's job, or find it in the cache."""
    receiver = scene.job.receivers[index]
    with scene.meter.phase("prepare"):
        points = prepared(receiver)
        result_key, tape_key = scene.keys(index, points)
        known = scene.cache.get(result_key) if result_key else None
    if known is not None:
        scene.meter.done += len(points.origins)
        return unchanged(receiver.name, points, known)
    work = Work(scene, index, points, Tape(scene.cache, tape_key))
    solved = yield from work.solve()
    result, entry = work.result(solved), work.entry(solved)
    if result_key:
        kept = {name: getattr(result, name) for name in RESULT_ARRAYS}
        scene.cache.put(result_key, kept, entry)
    return Baked(result, entry, points, solved)


class Bake(ABC, Generic[What]):
    """The bake of one receiver at about so many ``expected`` places, by default its points, without
    bounces.  Of places that its tape knows only the map's own rays are traced.  What the rays meet
    is in ``met`` where a ``keeper`` is to keep it, for the places that were traced, one after the
    other.
    """

    def __init__(
        self,
        scene: Scene,
        index: int,
        points: Points,
        tape: Tape | PlaceTape,
        keeper: "Keeper | None" = None,
        *,
        expected: int | None = None,
    ) -> None:
        self._scene, self._points, self._tape, self._keeper = scene, points, tape, keeper
        self.met: list[Gathered] = []
        self._look: Look | None = None
        self._receiver, self._settings = scene.job.receivers[index], scene.job.settings
        self._occlusion = Remembered(lambda: scene.occlusion, tape)
        self._counts: Counts = Counter()
        self._before = dict(scene.meter.seconds)
        scene.world.begin()
        self._expected = len(points.origins) if expected is None else expected
        with scene.meter.phase("horizon"):
            horizon = scene.surroundings.horizon(
                self._receiver, points, self._expected, self._settings.rays
            )
        self._shortcuts = Shortcuts(horizon)
        self._effort = Effort(self._settings.rays)
        self._pilots = points
        self._error: float | None = None

    def solve(self) -> Generator[Progress, None, What]:
        """Trace and solve."""
        meter, tape = self._scene.meter, self._tape
        if tape.known:
            self._effort, self._error = Effort(**tape.report["effort"]), tape.report["error"]
        elif self._chooses():
            with meter.phase("effort"):
                steps = effort(self._pilots, self._occlusion, self._settings, self._shortcuts)
                self._effort = yield from meter.follow("effort", steps, 0, 1)
            self._counts[CAST] += self._effort.cast
        pilot = 0 if self._looks() else self._effort.pilot
        self._shortcuts = replace(self._shortcuts, pilot=pilot)
        expected = self._expected * (self._effort.rays + self._map_rays())
        with meter.phase("values"):
            found = self._found()
            solved = yield from meter.follow("transfer", found, self._expected, expected)
        error = self._error_of(solved.traced)
        tape.save({"effort": asdict(self._effort), "error": error})
        return solved

    def _chooses(self) -> bool:
        """Whether anything depends on the noise that is to be expected."""
        return True

    @abstractmethod
    def _found(self) -> Generator[int, None, What]:
        """What there is to find.  Yields the rays cast so far."""

    def _looks(self) -> bool:
        """Whether something looks at where rays end, and wants to see all of them."""
        return self._keeper is not None

    def _map_rays(self) -> float:
        """About how many rays a point traces towards the map's light."""
        return self._scene.world.turns * self._settings.map_rays / 2

    def _cast(self) -> int:
        """The rays cast so far, without looks."""
        return self._counts[CAST] + self._counts[MAP_RAYS]

    def _azimuths(self, origins: Array, normals: Array) -> npt.NDArray[np.float64] | None:  # noqa: ARG002
        """By what angles the rays of places are turned (M,); None is at random."""
        return None

    def _trace(self, origins: Array, normals: Array, rays: int) -> Generator[int, None, Array]:
        """Transfer, residuals, peaks and visibility (M, n² + 3 turns + peaks + v²) at ``origins``
        (M, 3)."""
        world, coefficients = self._scene.world.exact, self._settings.order**2
        gather, visibility_order = world.gather if world else None, self._settings.visibility_order
        columns = coefficients + (gather.columns if gather else 0) + visibility_order**2
        values = np.empty((len(origins), columns), np.float32)
        bits, known = self._tape.visibility(origins, normals, rays)
        places = Points(origins, normals, np.empty(0, np.int32))
        recorder = self._keeper.recorder() if self._keeper and not self._tape.known else None
        shown = self._keeper.shown_of(rays) if self._keeper else 1
        shortcuts = replace(self._shortcuts, shown=shown)
        with self._scene.meter.phase("transfer"):
            self._counts += yield from trace_all(
                places,
                self._occlusion,
                replace(self._settings, rays=rays),
                values,
                shortcuts=replace(shortcuts, bits=bits, known=known, look=self._look or recorder),
                gather=gather,
                visibility_order=visibility_order,
                azimuth=self._azimuths(origins, normals),
            )
        if self._keeper is not None and isinstance(self._tape, Tape):
            settings = replace(self._settings, rays=rays)
            again = self._keeper.retrace(places, self._occlusion, settings, shortcuts)
            self.met.append(self._keeper.keep(self._tape, recorder, len(origins), again))
        if world is not None:
            world.leave_residuals(values, coefficients)
        return values

    def _error_of(self, traced: Traced) -> float:
        """The error at the ``traced`` places, pooled; found once."""
        if self._error is None:
            with self._scene.meter.phase("estimate"):
                self._error = self._estimate(traced)
        return self._error

    def _estimate(self, traced: Traced) -> float:
        """The error for those with the most usual number of rays, and for the others by how it
        falls with rays."""
        if not len(traced.rays):
            return 0.0
        counts = np.bincount(traced.rays)
        usual = int(counts.argmax())
        mine = np.flatnonzero(traced.rays == usual)
        places = Points(traced.origins, traced.normals, self._points.element_points[:0])
        transfer = traced.values[:, : self._settings.order**2]
        settings = replace(self._settings, rays=usual)
        error, cast = estimate_error(places, self._occlusion, settings, transfer, mine)
        self._counts[CAST] += cast
        noisier = (usual / np.maximum(np.arange(len(counts)), 1)) ** FALL
        return error * float(np.sqrt(np.average(noisier**2, weights=counts)))

    def result(self, solved: Found) -> ReceiverResult:
        """The values of ``solved``, apart."""
        values, coefficients = solved.values, self._settings.order**2
        end = coefficients + 3 * self._scene.world.turns
        seen = values.shape[1] - self._settings.visibility_order**2
        return ReceiverResult(
            self._receiver.name,
            np.ascontiguousarray(values[:, None, :coefficients]),
            self._points.element_points,
            np.ascontiguousarray(values[:, coefficients:end]).reshape(len(values), -1, 3),
            np.ascontiguousarray(values[:, end:seen]),
            visibility_sh=np.ascontiguousarray(values[:, seen:]),
        )

    def entry(self, solved: Found) -> Entry:
        """What the report says of the receiver."""
        count, meter = len(self._points.origins), self._scene.meter
        repeated = int((self._points.element_points >= 0).sum()) - count
        names = {CAST, MAP_RAYS}
        skipped = {name: rays for name, rays in self._counts.items() if name not in names and rays}
        cast = self._cast() + self._occlusion.asked
        spent = {k: v - self._before.get(k, 0.0) for k, v in meter.seconds.items()}
        return {
            "name": self._receiver.name,
            "points": count,
            "elements": len(self._points.element_points),
            "samples": len(solved.traced.rays),
            "rays": cast,
            "map_rays": self._counts[MAP_RAYS],
            "rays_per_point": self._effort.rays,
            "skipped": {SAME_PLACE: repeated * self._effort.rays, **skipped},
            "seconds": {k: v for k, v in spent.items() if v > 0},
            "mrays_per_second": cast / max(spent.get("transfer", 0.0), 1e-9) / 1e6,
            "measured_error": None,
            **{k: v for k, v in solved.entry.items() if k != "rays"},
            "estimated_error": self._error,
        }


class Work(Bake[Solved]):
    """The bake of one receiver at its points."""

    def _chooses(self) -> bool:
        """See Bake."""
        settings = self._settings
        return bool(settings.tolerance) or may_fit(self._receiver, settings, settings.rays)

    def _found(self) -> Generator[int, None, Solved]:
        """Values of the points.  Yields the rays cast so far."""
        solved = yield from solve(
            self._receiver,
            self._points,
            self._trace,
            self._occlusion,
            self._settings,
            rays=self._effort.rays,
            noise=self._effort.noise if self._chooses() else self._error_of,
        )
        if self._scene.world.exact is not None:
            self._scene.world.exact.add_light(solved.values, solved.lost)
        return solved

    def interpolation_error(self) -> Generator[int, None, float]:
        """About how wrong values of the points alone would be between them, relative to all, from
        a pilot.  Yields the rays cast so far."""
        found = yield from effort(self._pilots, self._occlusion, self._settings, self._shortcuts)
        rays, noise = min(found.rays, PILOT_RAYS), found.noise
        noise *= (found.rays / rays) ** FALL
        settings = self._settings
        return (
            yield from pilot_error(
                self._receiver, self._points, self._trace, settings, rays=rays, noise=noise
            )
        )
