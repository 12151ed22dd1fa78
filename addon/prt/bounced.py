"""All receivers of a job together, with light that bounces from surface to surface.

The direct pass of each receiver keeps what its rays meet; a bounce is a gather over that.  With B_0
the transfer, and the exact light, that arrive directly, and albedo rho,

    B_k(x) = mean over the rays of x of rho(y) B_k-1(y), y being where each ray ends,

and the transfer is the sum of all B_k.  1/pi and the albedo of what is met are inside of it, the
albedo of the surface itself is not.  What the gather reads at y are the values of the points there;
what it fills are the places that were traced, from which points get their values as they do without
bounces.

Texels are known only once they are traced.  For receivers in textures light bounces among places on
everything about them (``surfaces.py``), and the rays of a texel gather once what leaves there.
"""

import hashlib
from collections.abc import Generator, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import numpy.typing as npt

from . import sh
from .baking import Baked, Far, Scene, Work, prepared, unchanged
from .bands import exit_radiance
from .bounces.entries import Entries
from .bounces.hits import Gathered, Leaving
from .bounces.keeper import Keeper
from .bounces.sources import Sources
from .bounces.unbaked import ROUNDS, Unbaked
from .digests import add_array
from .job import ALL, RECEIVER_ARRAYS, Job, Progress
from .results import RESULT_ARRAYS, ReceiverResult
from .surface.points import Points
from .tape import Remembered, Tape
from .texture.places import pilot_points
from .tracing.transfer import CAST, MAP_RAYS, Counts, Shortcuts, trace_all
from .vertex.solver import Solved

Array = npt.NDArray[np.float32]
Index = npt.NDArray[np.int64]
Mask = npt.NDArray[np.bool_]

MOST = 256  # bounces, where they go on until nothing is left
LEFT = 1e-3  # of the light may be left out by the bounces that are not followed, without tolerance
NOTHING = 1e-7
OPEN = float(sh.open_transfer([0.0, 0.0, 1.0], 1)[0])  # first coefficient of all of the sky


def bake_all(scene: Scene) -> Generator[Progress, None, list[Baked]]:
    """Bake every receiver of the scene's job, or find all of them in the cache."""
    job, meter = scene.job, scene.meter
    yield meter.progress("prepare")
    with meter.phase("prepare"):
        points = [prepared(receiver) for receiver in job.receivers]
        entries = Entries.of(job, points)
        far = far_of(job, entries) if job.settings.cache else None
        keys = [scene.keys(index, its, far) for index, its in enumerate(points)]
        known = [scene.cache.get(key) if key else None for key, _ in keys]
    if all(known):
        meter.done += sum(len(its.origins) for its in points)
        named = zip(job.receivers, points, known, strict=True)
        return [unchanged(r.name, its, entry) for r, its, entry in named if entry is not None]
    tape = Tape(scene.cache, unbaked_key(scene, points[0], far) if far else "")
    bounces = Bounces(scene, points, entries, tape)
    for index, (_, tape_key) in enumerate(keys):
        yield from bounces.direct(index, Tape(scene.cache, tape_key))
    with meter.phase("bounces"):
        yield from bounces.unbaked(bounces.met())
        yield from bounces.follow()
        baked = [bounces.baked(index) for index in range(len(points))]
    for (key, _), one in zip(keys, baked, strict=True):
        if key:
            kept = {name: getattr(one.result, name) for name in RESULT_ARRAYS}
            scene.cache.put(key, kept, one.entry)
    return baked


def far_of(job: Job, entries: Entries) -> Far:
    """What light that bounces depends on: everything.  Where rays end depends on all of the
    geometry; what comes back from there on all albedos and on how other receivers are solved."""
    met = hashlib.blake2b(digest_size=20)
    for name in ("occluder_vertices", "occluder_triangles"):
        add_array(met, name, getattr(job, name))
    for name in ("first", "levels"):
        add_array(met, name, getattr(entries, name))
    rays = met.copy()
    for receiver in job.receivers:
        for name in RECEIVER_ARRAYS:
            add_array(rays, name, getattr(receiver, name))
    back = rays.copy()
    add_array(back, "albedo", job.occluder_albedo)
    return Far(back.digest(), met.digest(), rays.digest())


def unbaked_key(scene: Scene, points: Points, far: Far) -> str:
    """Names what is traced of things that are not baked, which depends on where all rays of the
    receivers end and on how many bounces reach them."""
    rounds = _rounds(scene.job.bounces)
    return scene.keys(0, points, Far(b"", far.rays + bytes([rounds])))[1]


def _rounds(bounces: int) -> int:
    return ROUNDS if bounces == ALL else min(bounces, ROUNDS)


@dataclass(frozen=True)
class _Direct:
    """A receiver's direct light: its ``work``, what that ``solved``, and where its points are among
    all nodes."""

    work: Work
    solved: Solved
    nodes: slice


class Bounces:
    """The receivers of a job with P points in all, and N nodes, which are these points and places
    on what is not baked; without points all nodes are such places.

    K columns: the transfer, channel by channel, then three for each turn of exact light.
    """

    def __init__(
        self, scene: Scene, points: Sequence[Points], entries: Entries, tape: Tape
    ) -> None:
        self._scene, self._points, self._entries, self._tape = scene, points, entries, tape
        job = scene.job
        self._settings = job.settings
        self._channels = scene.channels
        self._coefficients, self._turns = job.settings.order**2, scene.world.turns
        of_transfer = np.repeat(np.arange(self._channels), self._coefficients)
        self._channel = np.concatenate([of_transfer, np.tile(np.arange(3), self._turns)])
        self._keeper = Keeper(
            lambda: scene.occlusion, entries, job.settings.seed, job.settings.threads
        )
        self._direct: list[_Direct] = []
        self._count = sum(len(its.origins) for its in points)
        vertices, triangles = job.occluder_vertices, job.occluder_triangles
        occlusion = Remembered(lambda: scene.occlusion, tape)
        self._unbaked = Unbaked(
            entries, np.asarray(vertices), np.asarray(triangles), occlusion, self._count
        )
        self._found: list[Array] = []
        self._report: dict[str, Any] = {}

    def direct(self, index: int, tape: Tape) -> Generator[Progress, None, None]:
        """Bake receiver ``index`` without bounces, and keep what its rays meet."""
        work = Work(self._scene, index, self._points[index], tape, self._keeper)
        solved = yield from work.solve()
        before = self._direct[-1].nodes.stop if self._direct else 0
        nodes = slice(before, before + len(self._points[index].origins))
        self._direct.append(_Direct(work, solved, nodes))

    def met(self) -> Mask:
        """The entries (2 count,) that the rays of the receivers end at."""
        used = np.zeros(2 * self._entries.count, bool)
        for one in self._direct:
            _mark(used, one.work.met, one.solved.projection.unseen)
        return used

    def glanced(self, indices: Sequence[int]) -> Generator[Progress, None, Mask]:
        """As ``met``, from some places on the receivers ``indices``, which have no points."""
        scene, settings = self._scene, self._settings
        used = np.zeros(2 * self._entries.count, bool)
        for index in indices:
            places = pilot_points(scene.job.receivers[index], seed=settings.seed)
            again = self._keeper.retrace(places, scene.occlusion, settings, Shortcuts())
            recorder = None if self._tape.known else self._keeper.recorder()
            if recorder is not None:
                yield from scene.meter.follow("bounces", again(recorder), 0, 1)
            count = len(places.origins)
            its = self._keeper.keep(self._tape, recorder, count, again)
            _mark(used, [its], np.zeros(count, bool))
        return used

    def unbaked(self, used: Mask) -> Generator[Progress, None, None]:
        """Trace places on those of the entries ``used`` (2 count,) that are not baked, and on what
        is met from there, as far as the bounces reach."""
        meter, before, rounds = self._scene.meter, 0, _rounds(self._settings.bounces)
        for k in range(rounds):
            steps = self._unbaked.add(
                np.flatnonzero(used), self._trace, self._settings.rays, k == rounds - 1
            )
            yield from meter.follow("bounces", steps, 0, 1)
            fresh = [met for met in self._unbaked.gathered[before:] if met is not None]
            if not fresh:
                break
            _mark(used, fresh, np.concatenate(self._unbaked.unseen[before:]))
            before = len(self._unbaked.gathered)
        self._tape.save({})
        if not self._count:  # those who gather here come later
            self._unbaked.spread()
            used |= self._unbaked.nodes >= 0
        self._used = np.flatnonzero(used)
        counts = self._unbaked.counts
        looks = 0 if self._tape.known else self._unbaked.looks
        self._report.update(
            unbaked_places=self._unbaked.places,
            unbaked_rays=counts[CAST] + counts[MAP_RAYS] + looks,
            entries_without_light=int((self._unbaked.nodes[self._used] < 0).sum()),
        )

    def _trace(
        self, places: Points, rays: int, look: bool
    ) -> Generator[int, None, tuple[Array, Gathered | None, Counts]]:
        """See ``keeper.Trace``."""
        world, occlusion = self._scene.world.exact, self._scene.occlusion
        gather = world.gather if world else None
        columns = self._coefficients + (gather.columns if gather else 0)
        values = np.empty((len(places.origins), columns), np.float32)
        settings = replace(self._settings, rays=rays)
        recorder = self._keeper.recorder() if look and not self._tape.known else None
        bits, known = self._tape.visibility(places.origins, places.normals, rays)
        shortcuts = Shortcuts(look=recorder, bits=bits, known=known)
        counts = yield from trace_all(
            places, occlusion, settings, values, shortcuts=shortcuts, gather=gather
        )
        if not look:
            return values, None, counts
        again = self._keeper.retrace(places, occlusion, settings, Shortcuts())
        return values, self._keeper.keep(self._tape, recorder, len(values), again), counts

    def follow(self) -> Generator[Progress, None, tuple[Sources, Array]]:
        """Follow the light from bounce to bounce, and add up what arrives at the places that were
        traced.  The value is all sources, and what arrives in all at the nodes of the receivers
        (P, K); where there are none, at all nodes and with a bounce less, for that is the one of
        those who gather there."""
        sources, values = self._sources(), self._arriving()
        mine = slice(0, self._count or len(values))
        total = values[mine].copy()
        columns = len(self._channel)
        places = [len(one.solved.traced.rays) for one in self._direct]
        self._found = [np.zeros((count, columns), np.float32) for count in places]
        added: list[float] = []
        wanted = self._settings.bounces
        most = MOST if wanted == ALL else wanted - (not self._count)
        for _ in range(most):
            table = sources.table(values, self._channel)
            values = np.zeros_like(values)
            for index, one in enumerate(self._direct):
                found = np.empty_like(self._found[index])
                hidden = _hidden(one.solved.traced.values)
                yield from self._gather(one.work.met, table, sources, hidden, found)
                self._found[index] += found
                values[one.nodes] = one.solved.projection.rough(found)
            yield from self._gather_unbaked(table, sources, values)
            _bound(values, self._channels, self._coefficients)
            total += values[mine]
            added.append(_rms(values[mine]) / max(_rms(total), 1e-300))
            if added[-1] < NOTHING or (wanted == ALL and self._is_done(added)):
                break
        self._report.update(bounces=len(added) + (not self._count), added=added)
        return sources, total

    def _is_done(self, added: list[float]) -> bool:
        """Whether the bounces after those that ``added`` their share are too little to follow."""
        ratio = added[-1] / max(added[-2], 1e-300) if len(added) > 1 else 1.0
        rest = added[-1] * ratio / max(1 - ratio, 1e-3)
        return rest < (self._settings.tolerance or LEFT)

    def _gather(
        self, met: Sequence[Gathered], table: Array, sources: Sources, hidden: Array, out: Array
    ) -> Generator[Progress, None, None]:
        """Fill ``out`` (M, K) for places of whose rays a share ``hidden`` (M,) ``met`` something,
        one part after the other."""
        before = 0
        for part in met:
            rows = slice(before, before + part.count)
            steps = part.gather(table, sources.of_entries, hidden[rows], out[rows])
            yield from self._scene.meter.follow("bounces", steps, 0, 1)
            before += part.count

    def _gather_unbaked(
        self, table: Array, sources: Sources, values: Array
    ) -> Generator[Progress, None, None]:
        """Fill the nodes that are not baked."""
        before = self._count
        for met, direct in zip(self._unbaked.gathered, self._unbaked.values, strict=True):
            rows = values[before : before + len(direct)]
            if met is not None:
                yield from self._gather([met], table, sources, _hidden(direct), rows)
            before += len(direct)

    def _sources(self) -> Sources:
        """What the entries that rays end at are."""
        albedo = self._entries.albedo(self._used, np.asarray(self._scene.job.occluder_albedo))
        if self._channels == 1:
            albedo = albedo.mean(axis=1, keepdims=True)
        return Sources.of(self._unbaked.nodes, self._used, albedo)

    def _arriving(self) -> Array:
        """What arrives at all nodes directly (N, K)."""
        direct = [self._columns(self._with_light(one.solved.values)) for one in self._direct]
        nowhere = np.zeros((0, len(self._channel)), np.float32)
        return np.concatenate([nowhere, *direct, *map(self._columns, self._unbaked.values)])

    def _with_light(self, values: Array) -> Array:
        """``values`` (P, n² + 3 turns + peaks) with exact exit radiance instead of residuals."""
        world, shown = self._scene.world.exact, values.copy()
        if world is not None:
            world.leave_residuals(shown, self._coefficients, -1.0)
        return shown

    def _columns(self, values: Array) -> Array:
        """``values`` (P, n² + 3 turns + peaks) as K columns, the light not negative."""
        n, light = self._coefficients, 3 * self._turns
        transfer = np.tile(values[:, :n], (1, self._channels))
        return np.concatenate([transfer, np.maximum(values[:, n : n + light], 0)], axis=1)

    def leaving(self, sources: Sources, total: Array) -> tuple[Leaving, dict[str, Any]]:
        """What leaves ``sources`` where ``total`` (N, K) arrives, for a final gather, and what the
        report says of it."""
        table = sources.table(total, self._channel)
        report = {**self._report, "channels": self._channels}
        return Leaving(self._keeper.meeting, table, sources.of_entries), report

    def baked(self, index: int) -> Baked:
        """Receiver ``index`` with all light."""
        one, points = self._direct[index], self._points[index]
        plain = one.work.result(one.solved)
        columns = self._coefficients * self._channels
        more = one.solved.projection.final(self._found[index], columns)
        result = with_bounces(self._scene, plain, more)
        entry = {**one.work.entry(one.solved), **self._report, "channels": self._channels}
        return Baked(result, entry, points, one.solved)


def with_bounces(scene: Scene, plain: ReceiverResult, more: Array) -> ReceiverResult:
    """``plain``, the direct light alone, and the light of bounces, ``more`` (P, K): transfer,
    channel by channel, then exact light."""
    coefficients, turns = plain.transfer.shape[2], plain.residual.shape[1]
    channels = (more.shape[1] - 3 * turns) // coefficients
    added, light = np.split(more, [channels * coefficients], axis=1)
    transfer = added.reshape(len(more), channels, coefficients).copy()
    first = transfer[:, :, 0]
    np.maximum(first, 0, out=first)
    transfer += plain.transfer
    np.minimum(first, OPEN, out=first)  # a white sky lights nothing more than white
    residual = plain.residual + np.maximum(light, 0).reshape(len(more), turns, 3)
    if turns:
        assert scene.world.exact is not None
        for k, radiance in enumerate(scene.world.exact.radiance_sh):
            its = radiance[:coefficients]
            residual[:, k] -= exit_radiance(transfer, its) - exit_radiance(plain.transfer, its)
    whole = replace(plain, transfer=transfer, residual=residual.astype(np.float32))
    return whole.with_direct(plain) if scene.job.settings.keep_direct else whole


def _bound(values: Array, channels: int, coefficients: int) -> None:
    """Hold what arrives at nodes (N, K) to what light can be: the first coefficient of its
    transfer, and exact light, not negative."""
    first = values[:, : channels * coefficients : coefficients]
    np.maximum(first, 0, out=first)
    light = values[:, channels * coefficients :]
    np.maximum(light, 0, out=light)


def _mark(used: npt.NDArray[np.bool_], met: Sequence[Gathered], unseen: Any) -> None:
    """Mark in ``used`` (2 count,) the entries that are ``met`` by the rays of places, one part
    after the other, but for those of ``unseen`` places (M,), which are inside of something."""
    before = 0
    for part in met:
        hidden = unseen[before : before + part.count]
        for numbers, entries in part.entries():
            its = entries[~hidden[numbers]] if hidden.any() else entries
            used[its.reshape(-1).take(np.flatnonzero(its >= 0))] = True
        before += part.count


def _hidden(values: Array) -> Array:
    """The share (M,) of the rays of places that meets something, by the ``values`` (M, K) that were
    found there: the first coefficient counts the rays that reach the sky."""
    return np.asarray(np.clip(1 - values[:, 0] / np.float32(OPEN), 0, 1))


def _rms(values: Array) -> float:
    return float(np.sqrt(np.square(values, dtype=np.float64).mean())) if values.size else 0.0
