"""Values of the texels of a receiver: traced where they must be, interpolated between, filled where
the surface lies inside of other things, and stitched along seams."""

from collections.abc import Generator
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import numpy.typing as npt

from ..job import Receiver, Settings
from ..surface.points import Float, Index
from ..surface.samples import random_places
from ..tracing.rays import Occlusion
from ..vertex.traced import FALL, Trace, Traced
from .cover import cover
from .edges import edges_of
from .fill import AROUND, grow
from .places import Array, Mesh
from .refine import BETWEEN, BURIED, PIECE, SHARES, TRACED, Grid, Refinement
from .sampling import footprint
from .stitch import FOUND, Samples, Wanted, in_atlas, outside, sharpen, stitch
from .tracer import ASKEW, CENTRE, NOWHERE, Tracer

LEAST = 1e-3  # relative error that is always let pass: nobody sees it, and noise is above it
UNEVEN = 24.0  # times the tolerance: a texel that differs by more is looked at within
NOISIER = (len(ASKEW) / SHARES[1]) ** FALL  # than a texel with all rays: a place within one
RINGS = 2  # of buried texels about those that are not: what a read beside them touches
PROBES = (64, 1024)  # the fewest and the most places that tell the error over the surface
PROBE_SHARE = 1 / 64  # of the texels traced
PROBE_RAYS = 4.0  # times a texel's
READ = 4 / 9  # of the texels' squared noise is left in a bilinear read, in the mean


@dataclass(frozen=True)
class Texels:
    """``values`` (T, K) float32 of the texels ``index`` (T,), row r and column c at r N + c, in
    rising order; ``entry``, what the report says about them; ``traced``, places that rays started
    from, or some of them."""

    index: Index
    values: Array
    entry: dict[str, Any]
    traced: Traced


def solve(  # noqa: PLR0917 - as for vertices, and where it lies
    receiver: Receiver,
    uvs: Array,
    size: int,
    trace: Trace,
    occlusion: Occlusion,
    settings: Settings,
    *,
    rays: int,
    noise: float,
    light: Float | None = None,
    bounced: int = 0,
) -> Generator[int, None, Texels]:
    """Values of the texels of ``receiver`` in an atlas of ``size``², where its corners lie at
    ``uvs`` (C, 2), out of about ``rays`` a texel, whose tracing has a relative error of ``noise``.

    ``light`` (turns, n², 3), the radiance coefficients at each turn, tells how much of what an
    artist sees the residual columns are; without it they count for themselves.  So many columns
    are light that has ``bounced``, the last ones before the visibility.  Yields the rays cast so
    far.
    """
    mesh = Mesh.of(receiver, uvs, size)
    index, triangles, beside = yield from cover(mesh.layout, mesh.surface.solid)
    edges = edges_of(receiver, mesh.surface, mesh.layout)
    grid = Grid.of(size, index, edges.region[triangles])
    tracer = Tracer(mesh, index, triangles, trace, occlusion, order=settings.order, rays=rays)
    work = Refinement(grid, tracer)
    yield from work.start()
    first = work.values[work.state == TRACED]
    scale = Scale.of(first, settings.order**2, light, settings.visibility_order**2, bounced)
    tolerance = max(settings.tolerance or noise, LEAST)
    yield from work.go_on(scale, tolerance)
    yield from _push_out(work, grid, tracer, edges.region)
    charts = Grid.of(size, index, edges.chart[triangles])
    smooth = settings.order**2  # columns, whose noise is known
    of_transfer = Scale.of(first[:, :smooth], smooth, None)
    yield from _look_within(work, charts, tracer, of_transfer, UNEVEN * tolerance)
    known = work.state != BURIED
    grow(charts, work.values, known, RINGS)
    values = work.values[known]
    at = Grid.of(size, index[known], grid.region[known]).at
    inside, its = tracer.inside
    within = Wanted.at(in_atlas(mesh.layout, inside), its, 1.0, at)
    sharpened = sharpen(values, within, smooth, of_transfer, noise * NOISIER)
    yield from _counted(tracer, sharpened)
    seams = Samples.across(edges.seams, size, at)
    before = seams.read(values)
    found = work.state[known] != BURIED
    border, away = yield from _border(tracer, values, at, np.flatnonzero(known), found, beside)
    yield from _counted(tracer, stitch(values, seams, border, within.samples, away))
    values[:, 0] = np.maximum(values[:, 0], 0)
    errors = yield from _errors(tracer, values, at, settings, noise)
    jumps = _seam_report(scale, before, seams.read(values))
    entry = {"rays": tracer.cast, **_counts(work, len(values)), "seams": jumps, **errors}
    return Texels(index[known], values, entry, tracer.traced)


def _counts(work: Refinement, texels: int) -> dict[str, int]:
    """What the report says of so many ``texels``, by how they came to their values."""
    counts = np.bincount(work.state, minlength=4)
    return {
        "texels": texels,
        "traced_texels": int(counts[TRACED]),
        "interpolated_texels": int(counts[BETWEEN]),
        "filled_texels": texels - int(counts[TRACED] + counts[BETWEEN]),
        "buried_points": int(counts[BURIED]),
    }


def _counted(tracer: Tracer, steps: Generator[None, None, None]) -> Generator[int, None, None]:
    """``steps`` that cast none; yields the rays cast so far."""
    for _ in steps:
        yield tracer.cast


@dataclass(frozen=True)
class Scale:
    """How large differences look: those of ``groups`` of columns, linear forms of the values, each
    relative to the RMS of its own."""

    groups: tuple[Array, ...]

    @classmethod
    def of(
        cls,
        values: Array,
        transfer: int,
        light: Float | None,
        visibility: int = 0,
        bounced: int = 0,
    ) -> "Scale":
        """Of ``values`` (M, K), of which the first ``transfer`` columns are the transfer, the last
        ``visibility`` ones what is seen, and the ``bounced`` ones before these light that bounced,
        which is shown together with the transfer and is as large as that."""
        columns = values.shape[1]
        each = np.eye(columns, dtype=np.float32)
        forms = [each[:, :transfer]]
        rest = transfer
        for radiance in () if light is None else light:
            seen = each[:, rest : rest + 3].copy()
            if seen.shape[1] == 3:  # exit radiance of a white surface: transfer and residual
                seen[:transfer] = radiance
                forms.append(seen)
                rest += 3
        end = columns - visibility
        pairs = [(form, form) for form in (*forms, each[:, rest : end - bounced], each[:, end:])]
        first, of_light = end - bounced, 3 * (len(forms) - 1) * bool(bounced)
        pairs.append((each[:, first : end - of_light], forms[0]))
        for k, form in enumerate(forms[1:] if bounced else ()):
            low = end - of_light + 3 * k
            pairs.append((each[:, low : low + 3], form))
        groups = []
        for form, shown in pairs:
            if form.size and len(values):
                rms = float(np.sqrt(np.mean((values @ shown) ** 2, dtype=np.float64)))
                groups.append(form / (max(rms, 1e-20) * form.shape[1] ** 0.5))
        return cls(tuple(groups))

    @property
    def columns(self) -> int:
        """How many columns it is for."""
        return len(self.groups[0]) if self.groups else 0

    @cached_property
    def _all(self) -> Array:
        """All groups side by side."""
        return np.concatenate(self.groups, axis=1)

    def __call__(self, differences: Array) -> Array:
        """The largest of what the groups say of ``differences`` (M, K), relative (M,)."""
        found = np.zeros(len(differences), np.float32)
        if self.groups:
            squares, end = np.square(differences @ self._all), 0
            for group in self.groups:
                its = squares[:, end : end + group.shape[1]]
                np.maximum(found, its @ np.ones(group.shape[1], np.float32), out=found)
                end += group.shape[1]
        return np.sqrt(found)


def _push_out(
    work: Refinement, grid: Grid, tracer: Tracer, region: Index
) -> Generator[int, None, None]:
    """Trace buried texels beside others that are not from where they are seen, if it is near."""
    rows = np.flatnonzero(work.state == BURIED)
    near = grid.neighbours(rows, AROUND)
    beside = ((near >= 0) & (work.state[near] != BURIED)).any(axis=1)
    out, places = yield from tracer.pushed_out(rows[beside], region)
    values, hidden = yield from tracer.follow(places, SHARES[1])
    work.values[out[~hidden]] = values[~hidden]
    work.state[out[~hidden]] = TRACED


def _look_within(
    work: Refinement, charts: Grid, tracer: Tracer, scale: Scale, most: float
) -> Generator[int, None, None]:
    """Trace several places within texels whose transfer differs by more than ``most`` from that of
    one of those about them on their chart, and where buried ones are seen after all: there that is
    their value."""
    buried, transfer = work.state == BURIED, work.values[:, : scale.columns]
    wanted = buried.copy()
    for first in range(0, len(buried), PIECE):
        rows = np.arange(first, min(first + PIECE, len(buried)))
        for step in AROUND[: len(AROUND) // 2]:  # the others are those seen from the other side
            near = charts.neighbours(rows, [step])[:, 0]
            both = (near >= 0) & ~buried[near] & ~buried[rows]
            far = both & (scale(transfer[rows] - transfer[near]) > most)
            wanted[rows[far]] = wanted[near[far]] = True
        yield tracer.cast
    of, found = yield from tracer.look_within(np.flatnonzero(wanted), buried, SHARES[1])
    of, found = of[buried[of]], found[buried[of]]
    counts = np.bincount(of, minlength=len(buried)).astype(np.float32)
    work.values[of] = 0
    np.add.at(work.values, of, found / counts[of, None])
    work.state[of] = TRACED


def _border(  # noqa: PLR0917 - one caller
    tracer: Tracer,
    values: Array,
    at: npt.NDArray[np.int32],
    rows: Index,
    found: npt.NDArray[np.bool_],
    beside: npt.NDArray[np.bool_],
) -> Generator[int, None, tuple[Wanted, Float]]:
    """What was found where texels lie beyond the border of their charts, and how far outside of its
    chart each texel lies (T,).  ``values`` (T, K) are those of the tracer's ``rows`` (T,), of which
    those that were ``found`` (T,) were not filled; ``at`` (N, N) is the place of each among them.
    Of the tracer's texels those lie outside whose centres are ``beside`` their triangles.  Yields
    the rays cast so far."""
    out, away = np.flatnonzero(beside[rows]), np.zeros(len(rows))
    places = in_atlas(tracer.mesh.layout, (yield from tracer.at(rows[out], CENTRE)))
    index = np.flatnonzero(at.reshape(-1) >= 0)[out]
    away[out] = outside(places, index, len(at))
    mine = (away[out] > 0) & found[out]
    return Wanted.at(places[mine], values[out[mine]], FOUND, at), away


def _seam_report(scale: Scale, before: Array, after: Array) -> dict[str, Any]:
    """What the report says of the jumps (S, K) across seams, relative to the object's RMS."""
    if not len(before):
        return {"samples": 0, "jump_before": 0.0, "jump_after": 0.0}
    jumps = [float(np.quantile(scale(jump), 0.999)) for jump in (before, after)]
    return {"samples": len(before), "jump_before": jumps[0], "jump_after": jumps[1]}


def _errors(
    tracer: Tracer, values: Array, at: npt.NDArray[np.int32], settings: Settings, noise: float
) -> Generator[int, None, dict[str, float]]:
    """The relative error over the surface, of the noise and of what lies between the texels, from
    places that are traced with many rays."""
    mesh, columns = tracer.mesh, settings.order**2
    count = int(np.clip(tracer.places * PROBE_SHARE, *PROBES)) * bool(len(values))
    places = NOWHERE
    if count:  # the first of always the same ones, so that another light's bake knows them
        places = random_places(mesh.surface.areas, PROBES[1], settings.seed)[:count]
    noisier = tracer.mean_noisier()
    found, hidden = yield from tracer.follow(places, PROBE_RAYS)
    uvs = np.einsum("pk,pkc->pc", places.barycentric, mesh.layout.corners[places.triangles])
    texels, weights = footprint((uvs + 0.5) / mesh.layout.size, mesh.layout.size)
    rows = at.reshape(-1)[texels]
    seen = ~hidden & ((rows >= 0) | (weights < 1e-6)).all(axis=1)
    shown = np.einsum("pj,pjk->pk", weights[seen], values[rows[seen], :columns])
    truth = found[seen, :columns]
    size = max(float(np.square(truth, dtype=np.float64).mean()) if truth.size else 0.0, 1e-300)
    missed = float(np.square(shown - truth).mean()) / size if truth.size else 0.0
    surface = max(missed - (noise * PROBE_RAYS**-FALL) ** 2, 0.0)
    of_noise = READ * (noise * noisier) ** 2
    return {
        "interpolation_error": max(surface - of_noise, 0.0) ** 0.5,
        "surface_error": surface**0.5,
    }
