"""The bake of receivers into atlases: unwrap, texels, images."""

import hashlib
import json
from collections.abc import Generator, Sequence
from dataclasses import dataclass, replace
from math import log2, sqrt
from typing import Any

import numpy as np
import numpy.typing as npt

from . import layout as layouts
from .atlas.unwrap import unwrap
from .atlas.uv_map import OVERLAPPING, overlap, problem
from .baking import Bake, Baked, Far, Scene, prepared, unchanged
from .bounced import with_bounces
from .bounces.hits import Leaving
from .errors import BakeError
from .job import Job, Progress, Receiver, Settings
from .layout import Layout
from .place_tape import PlaceTape
from .results import RESULT_ARRAYS, Atlas, InAtlas, ReceiverResult
from .surface.points import Points, Surface
from .surface.samples import random_places
from .surfaces import Surfaces
from .texture.fill import push_pull
from .texture.places import pilot_points
from .texture.sampling import footprint
from .texture.solver import Texels
from .texture.solver import solve as solve_texels
from .tiles import largest_size
from .tracing import identity
from .verify import Shown, shown_at
from .vertex.traced import Found

Array = npt.NDArray[np.float32]

USED = 0.6  # of an atlas is surface, about
TRACED = 0.15  # of its texels take rays, about
UNWRAP_POINTS = 3.0  # as long as so many points takes a face to be unwrapped, about
SMALLEST = 16  # texels a side
AREA_STEPS = 8  # of a doubling of an object's area leave its place in an atlas as it is


@dataclass(frozen=True)
class Plan:
    """An atlas to be made: the numbers of its ``receivers``, and a ``key`` that names what decides
    its UVs beside their shapes."""

    receivers: tuple[int, ...]
    key: str


@dataclass(frozen=True)
class Sheet:
    """An atlas with its ``uvs``, one array (C, 2) for each receiver of the ``plan``, of ``size``
    texels a side; no triangle comes nearer to its border than ``margin`` texels."""

    plan: Plan
    size: int
    uvs: tuple[Array, ...]
    margin: float
    own: bool


def plans(job: Job, chosen: Sequence[int]) -> list[Plan]:
    """Which of the receivers ``chosen`` share an atlas.

    Those with UV maps of the artist's have an atlas with those that they share materials with, and
    all others have one, or one for each group that shares materials.
    """
    groups: dict[int, list[int]] = {}
    for index in chosen:
        group = job.receivers[index].group
        groups.setdefault(group if group >= 0 else -1 - index, []).append(index)
    sheets, shared = [], []
    for members in groups.values():
        own = [i for i in members if _is_own(job.receivers[i])]
        if own and len(own) < len(members):
            other = next(job.receivers[i].name for i in members if i not in own)
            raise BakeError(
                f"{job.receivers[own[0]].name!r} has a UV map PRT of its own and shares a material "
                f"with {other!r}, which has none: rename the map, or give the other one too"
            )
        if own or not job.settings.shared_atlas:
            sheets.append(members)
        else:
            shared += members
    return [_plan(job, sorted(members)) for members in [*sheets, shared] if members]


def work_of(job: Job, chosen: Sequence[int]) -> float:
    """What baking the receivers ``chosen`` is, in points: about, until their atlases are known."""
    faces = sum(len(job.receivers[i].triangles) for i in chosen)
    return (UNWRAP_POINTS * faces + USED * TRACED * job.settings.resolution**2) * bool(chosen)


def laid_out(scene: Scene, plan: Plan) -> Generator[Progress, None, Sheet]:
    """The UVs of an atlas: those that the receivers have, where they can be used, else new ones.

    BakeError where the artist's own cannot be used.
    """
    receivers = [scene.job.receivers[i] for i in plan.receivers]
    meter, faces = scene.meter, sum(len(receiver.triangles) for receiver in receivers)
    share = UNWRAP_POINTS * faces
    done = meter.done
    own = any(map(_is_own, receivers))
    with meter.phase("unwrap"):
        uvs = _kept(receivers, plan.key, own)
        if uvs is None:
            size, uvs = yield from _unwrapped(scene, receivers, share)
        else:
            size = _size_for(scene.job, receivers, uvs)
    meter.done = done + share
    count = len(_columns(scene))
    if size > largest_size(-(-count // 4)):
        raise BakeError(
            f"An atlas of {size} texels a side with {count} numbers a texel is larger than "
            f"graphics cards take: choose at most {largest_size(-(-count // 4))}, or a lower order"
        )
    return Sheet(plan, size, uvs, _margin(scene.job, receivers, uvs, size), own)


def bake_texels(
    scene: Scene, index: int, sheet: Sheet, number: int, surfaces: Surfaces | None
) -> Generator[Progress, None, Baked]:
    """Bake receiver ``index`` of the scene's job into atlas ``number``, or find it in the cache;
    with the light that bounces off ``surfaces``."""
    receiver, uvs = scene.job.receivers[index], sheet.uvs[sheet.plan.receivers.index(index)]
    with scene.meter.phase("prepare"):
        points = prepared(receiver)
        digest = hashlib.blake2b(np.ascontiguousarray(uvs), digest_size=20)
        digest.update(json.dumps(sheet.size).encode())
        far = Far(digest.digest(), digest.digest())
        if surfaces:
            far = Far(far.result + surfaces.far.result, far.visibility + surfaces.far.visibility)
        result_key, tape_key = scene.keys(index, points, far)
        known = scene.cache.get(result_key) if result_key else None
    about = {
        "carrier": "texture",
        "atlas": number,
        "atlas_size": sheet.size,
        "uv_key": sheet.plan.key,
        "own_uvs": sheet.own,
    }
    if known is not None:
        baked = unchanged(receiver.name, points, known)
        where = InAtlas(number, uvs, np.array(known.arrays["texels"]))
        scene.meter.done += TRACED * len(where.texels)
        result = replace(baked.result, in_atlas=where)
        return replace(baked, result=result, entry={**baked.entry, **about})
    leaving = (yield from surfaces.leaving()) if surfaces else None
    tape = PlaceTape(scene.cache, tape_key)
    work = TextureWork(scene, index, points, sheet, uvs, tape, leaving)
    solved = yield from work.solve()
    result = replace(work.result(solved), in_atlas=InAtlas(number, uvs, work.texels))
    entry = {**work.entry(solved), **about, **(surfaces.report if surfaces else {})}
    if result_key:
        kept = {name: getattr(result, name) for name in RESULT_ARRAYS}
        scene.cache.put(result_key, {**kept, "texels": work.texels}, entry)
    return Baked(result, entry, points, solved)


class TextureWork(Bake[Found]):
    """The bake of one receiver into its texels, with what is ``leaving`` the surfaces about it.
    Which texels are traced follows from the light too, so how the rays of each are turned follows
    from where it lies: then its tape knows them again among others."""

    def __init__(  # noqa: PLR0917 - one caller
        self,
        scene: Scene,
        index: int,
        points: Points,
        sheet: Sheet,
        uvs: Array,
        tape: PlaceTape,
        leaving: Leaving | None,
    ) -> None:
        expected = max(1, round(TRACED * USED * sheet.size**2 / len(sheet.uvs)))
        super().__init__(scene, index, points, tape, expected=expected)
        self._uvs, self._size, self._places, self._leaving = uvs, sheet.size, tape, leaving
        self._pilots = pilot_points(self._receiver, seed=self._settings.seed)
        self.texels = np.empty(0, np.int64)

    def _found(self) -> Generator[int, None, Found]:
        """Values of the texels.  Yields the rays cast so far."""
        world = self._scene.world
        light = world.seen_sh[: world.turns, : self._settings.order**2] if world.turns else None
        found: Texels = yield from solve_texels(
            self._receiver,
            self._uvs,
            self._size,
            self._trace,
            self._occlusion,
            self._settings,
            rays=self._effort.rays,
            noise=self._effort.noise,
            light=light,
            bounced=self._leaving.table.shape[1] if self._leaving else 0,
        )
        self.texels = found.index
        return Found(found.values, {**found.entry, "points": len(found.index)}, found.traced)

    def _looks(self) -> bool:
        """See Bake."""
        return self._leaving is not None

    def _azimuths(self, origins: Array, normals: Array) -> npt.NDArray[np.float64]:
        """By their places: which texels are traced follows from the light."""
        return identity.azimuths(identity.keys(origins, normals), self._settings.seed)

    def _trace(self, origins: Array, normals: Array, rays: int) -> Generator[int, None, Array]:
        """As without bounces, and what these bring, before the visibility."""
        if self._leaving is None:
            return (yield from super()._trace(origins, normals, rays))
        more = np.zeros((len(origins), self._leaving.table.shape[1]), np.float32)
        ends = self._places.ends(origins, normals, rays)
        self._look = self._leaving.look(rays, more, ends)
        before = self._cast()
        direct, seen = self._apart((yield from super()._trace(origins, normals, rays)))
        for _ in self._leaving.recall(rays, more, ends, self._settings.threads):
            yield self._cast() - before
        return np.concatenate([direct, more, seen], axis=1)

    def _apart(self, values: Array) -> tuple[Array, Array]:
        """``values`` (M, K) without the visibility, and that."""
        count = values.shape[1] - self._settings.visibility_order**2
        return values[:, :count], values[:, count:]

    def result(self, solved: Found) -> ReceiverResult:
        """See Bake."""
        if self._leaving is None:
            return super().result(solved)
        rest, seen = self._apart(solved.values)
        direct, more = np.split(rest, [rest.shape[1] - self._leaving.table.shape[1]], axis=1)
        plain = super().result(replace(solved, values=np.concatenate([direct, seen], axis=1)))
        return with_bounces(self._scene, plain, more)


def between_texels(
    receiver: Receiver, result: ReceiverResult, size: int, count: int, seed: int
) -> Shown:
    """What a bilinear read of ``result`` shows at ``count`` random places of ``receiver``, in an
    atlas of ``size`` texels a side."""
    assert result.in_atlas is not None
    places = random_places(Surface.of(receiver).areas, count, seed)
    corners = result.in_atlas.uvs[receiver.triangle_corners[places.triangles]]
    uvs = np.einsum("pk,pkc->pc", places.barycentric, corners)
    texels, weights = footprint(uvs, size)
    row_of = np.full(size**2, -1)
    row_of[result.in_atlas.texels] = np.arange(len(result.in_atlas.texels))
    rows = row_of[texels]
    weights = np.where(rows >= 0, weights, 0)  # what is buried all round shows its neighbours
    weights /= np.maximum(weights.sum(axis=1, keepdims=True), 1e-12)

    def shown(values: npt.NDArray[Any]) -> npt.NDArray[np.float64]:
        return np.asarray(np.einsum("pj,pj...->p...", weights, values[rows].astype(np.float64)))

    residual = result.residual
    return shown_at(
        receiver,
        places,
        shown(result.transfer),
        shown(residual[:, 0]) if residual.shape[1] else None,
        shown(result.visibility_sh),
    )


def painted(
    sheet: Sheet, results: Sequence[ReceiverResult], number: int, settings: Settings
) -> Generator[None, None, Atlas]:
    """Atlas ``number``, of ``sheet``, from the ``results`` in it, all of it filled, and without
    light that bounced where that was kept.  Yields now and then."""
    mine = [result for result in results if result.in_atlas and result.in_atlas.atlas == number]
    layout = layouts.covering(results)
    names = tuple(name for name in layout.slots if name)
    image = np.zeros((sheet.size**2, len(names)), np.float32)
    known = np.zeros(sheet.size**2, bool)
    for result in mine:
        assert result.in_atlas is not None
        values = layouts.pack(layout, layouts.at_points(result))
        image[result.in_atlas.texels] = values[:, : len(names)]
        known[result.in_atlas.texels] = True
        yield
    square = image.reshape(sheet.size, sheet.size, -1)
    yield from push_pull(square, known.reshape(sheet.size, sheet.size))
    direct = [result.direct for result in results if result.direct is not None]
    return Atlas(
        sheet.size,
        names,
        sheet.margin,
        settings.half,
        square,
        engine_images=settings.engine_images,
        direct=(yield from painted(sheet, direct, number, settings)) if direct else None,
    )


def _is_own(receiver: Receiver) -> bool:
    """Whether its UVs are the artist's."""
    return receiver.uvs is not None and not receiver.uv_key


def _plan(job: Job, members: Sequence[int]) -> Plan:
    settings = job.settings
    decisive: list[Any] = [settings.texel_density or settings.resolution, settings.padding_mip]
    for index in members:
        receiver = job.receivers[index]
        area = float(Surface.of(receiver).areas.sum())
        decisive.append((receiver.name, round(AREA_STEPS * log2(max(area, 1e-30)))))
    digest = hashlib.blake2b(json.dumps(decisive).encode(), digest_size=12)
    return Plan(tuple(members), digest.hexdigest())


def _kept(receivers: Sequence[Receiver], key: str, own: bool) -> tuple[Array, ...] | None:
    """The UVs that all the receivers of an atlas have already, None where they have to be made."""
    uvs = [np.asarray(r.uvs) for r in receivers if r.uvs is not None and (own or r.uv_key == key)]
    if len(uvs) < len(receivers):
        return None
    problems = (problem(r, its) for r, its in zip(receivers, uvs, strict=True))
    found = next((sentence for sentence in problems if sentence), None)
    if found is None and len(receivers) > 1:
        corners = [its[r.triangle_corners] for r, its in zip(receivers, uvs, strict=True)]
        if overlap(np.concatenate(corners).astype(np.float64)) > OVERLAPPING:
            names = " and ".join(repr(receiver.name) for receiver in receivers[:2])
            found = f"The UV maps of {names} lie over each other, and they share a material"
    if found is None:
        return tuple(uvs)
    if own:
        raise BakeError(f"{found}: rename the map PRT, and the bake makes its own")
    return None


def _unwrapped(
    scene: Scene, receivers: Sequence[Receiver], share: float
) -> Generator[Progress, None, tuple[int, tuple[Array, ...]]]:
    """Size and UVs of a new atlas."""
    settings, meter, done = scene.job.settings, scene.meter, scene.meter.done
    steps = unwrap(
        receivers,
        size=0 if settings.texel_density else settings.resolution,
        density=settings.texel_density,
        padding=2**settings.padding_mip,
        threads=settings.threads,
    )
    while True:
        try:
            fraction = next(steps)
        except StopIteration as stop:
            return stop.value.size, tuple(stop.value.uvs)
        meter.done = done + share * fraction
        yield meter.progress("unwrap")


def _size_for(job: Job, receivers: Sequence[Receiver], uvs: Sequence[Array]) -> int:
    """The side of an atlas whose UVs are given: as asked, or the power of two that is dense enough
    for all of them together."""
    if not job.settings.texel_density:
        return job.settings.resolution
    in_world = sum(float(Surface.of(receiver).areas.sum()) for receiver in receivers)
    in_atlas = sum(
        float(np.abs(_doubled(its[r.triangle_corners])).sum()) / 2
        for r, its in zip(receivers, uvs, strict=True)
    )
    texels = job.settings.texel_density * sqrt(in_world / max(in_atlas, 1e-12))
    return int(2 ** np.ceil(np.clip(log2(texels), log2(SMALLEST), 14)))


def _doubled(corners: Array) -> npt.NDArray[np.float64]:
    """Twice the signed areas (F,) of triangles (F, 3, 2)."""
    a, b = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    return np.asarray(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0], np.float64)


def _margin(job: Job, receivers: Sequence[Receiver], uvs: Sequence[Array], size: int) -> float:
    """How many texels inside its border an atlas may be read from, at most as many as the mip level
    has that charts stay apart up to, and half a texel at least."""
    used = [its[r.triangle_corners].reshape(-1, 2) for r, its in zip(receivers, uvs, strict=True)]
    all_uvs = np.concatenate(used)
    nearest = size * float(np.minimum(all_uvs, 1 - all_uvs).min(initial=0.5))
    return float(max(0.5, min(nearest, 0.5 * 2**job.settings.padding_mip)))


def _columns(scene: Scene) -> tuple[str, ...]:
    """What a texel holds at most."""
    settings = scene.job.settings
    turns, visibility = scene.world.turns, settings.visibility_order
    layout = Layout(settings.order, scene.channels, turns, settings.peaks, visibility)
    return tuple(name for name in layout.slots if name)
