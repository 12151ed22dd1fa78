"""What a run of the engine leaves: values of every receiver, the light's coefficients, a report.

``write_results`` and ``read_results`` are inverse.  All lies in the job's sub-folder ``results``,
which exists only when all of it is there:

    report.json             names of the receivers, atlases, peaks, the JSON report
    light.npy               see ``Results.image_sh``
    transfer.npy ...        the arrays of all receivers, see ``ReceiverResult``, one receiver's
                            after the other's, flat: ``shapes`` in the report tell them apart; of
                            one in an atlas only some of the points, and its uvs
    atlas_0.exr ...         see ``Atlas``; atlas_0_0.exr ... or atlas_0_0.png ..., atlas_0.json for
                            engines, see ``files/layers.py``; direct_0.exr ... without bounces
    reflections.exr         see ``Reflections``
"""

import json
from collections.abc import Iterator
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from .arrays import read_all, write_all
from .job import Array, EngineImages, Peak

if TYPE_CHECKING:
    from .specular.sheet import Sheet

RESULTS = "results"
RESULT_ARRAYS = (
    "transfer",
    "element_points",
    "residual",
    "visibility",
    "visibility_sh",
    "direct_transfer",
    "direct_residual",
)
HEADER = ("size", "names", "margin", "half")  # of an atlas
REFLECTIONS = "reflections.exr"
SOME = 1 << 16  # points of a texture that are left for who wants to know about all


@dataclass(frozen=True)
class InAtlas:
    """Where a receiver is: in atlas number ``atlas``, with ``uvs`` (C, 2) float32, one a corner, in
    [0, 1]; its points are the ``texels`` (P,), row * size + column, row 0 at the bottom."""

    atlas: int
    uvs: Array
    texels: Array = field(default_factory=lambda: np.empty(0, np.int64))


@dataclass(frozen=True)
class ReceiverResult:
    """Baked values of P distinct points, float32: ``transfer`` (P, channels, n²), ``residual``
    (P, turns, 3), exit radiance of a white surface that the transfer misses at the baked light,
    ``visibility`` (P, lights) of the lights cut out, and ``visibility_sh`` (P, v²), the
    coefficients of what each point sees (``tracing/visibility.py``); turns, lights and v may be 0.
    For each element of the domain the point that it shows, ``element_points`` (E,) int32, -1 where
    it has none; no elements where the points are texels (``in_atlas``).  ``direct_transfer``
    (P, 1, n²) and ``direct_residual`` (P, turns, 3) lack the light that bounced, where they were
    kept."""

    name: str
    transfer: Array
    element_points: Array
    residual: Array = field(default_factory=lambda: np.empty((0, 0, 3), np.float32))
    visibility: Array = field(default_factory=lambda: np.empty((0, 0), np.float32))
    in_atlas: InAtlas | None = None
    visibility_sh: Array = field(default_factory=lambda: np.empty((0, 0), np.float32))
    direct_transfer: Array = field(default_factory=lambda: np.empty((0, 0, 0), np.float32))
    direct_residual: Array = field(default_factory=lambda: np.empty((0, 0, 3), np.float32))

    def __post_init__(self) -> None:
        """What is not stored: arrays of the right length."""
        for name in RESULT_ARRAYS[2:]:
            value = getattr(self, name)
            if not value.size:
                shape = (len(self.transfer), *value.shape[1:])
                object.__setattr__(self, name, np.empty(shape, np.float32))

    @property
    def direct(self) -> "ReceiverResult | None":
        """The same without light that bounced, and without what is seen, which doesn't depend on
        it; None where that was not kept."""
        if not self.direct_transfer.shape[1]:
            return None
        return ReceiverResult(
            self.name,
            self.direct_transfer,
            self.element_points,
            self.direct_residual,
            self.visibility,
            self.in_atlas,
        )

    def with_direct(self, direct: "ReceiverResult") -> "ReceiverResult":
        """The same, and ``direct`` without light that bounced."""
        return replace(self, direct_transfer=direct.transfer, direct_residual=direct.residual)

    def at_elements(self, values: Array) -> Array:
        """``values`` (P, ...), one of the arrays above, at every vertex or corner (E, ...), 0 where
        nothing was traced."""
        shown: Array = values[self.element_points]
        shown[self.element_points < 0] = 0
        return shown


@dataclass(frozen=True)
class Atlas:
    """An image of ``size`` x ``size`` texels, whose columns are called ``names``: ``image``
    (N, N, K) float32, row 0 at the bottom, until it is written, and its ``path`` from then on; no
    surface lies nearer to its border than ``margin`` texels.  ``half`` is how it is stored.  Where
    ``engine_images`` are asked for, they are ``files`` whose names go on from that of ``path``.
    ``direct`` is the same without light that bounced, where that was kept."""

    size: int
    names: tuple[str, ...]
    margin: float
    half: bool = False
    image: Array | None = None
    path: Path | None = None
    engine_images: EngineImages = ""
    files: tuple[Path, ...] = ()
    direct: "Atlas | None" = None


@dataclass(frozen=True)
class Reflections:
    """What shiny surfaces reflect: ``image`` (H, W, 4) half floats, row 0 at the bottom, laid out
    as ``sheet`` says, until it is written, and its ``path`` from then on.  It lacks ``peaks``,
    which are in the picture's own frame and for a strength of 1."""

    sheet: "Sheet"
    peaks: tuple[Peak, ...] = ()
    image: Array | None = None
    path: Path | None = None


@dataclass(frozen=True)
class Results:
    """What a run leaves: ``image_sh`` (25, 3) float64 is the light's image (or 1, where there is
    none) unrotated and without its strength, its peaks included; ``peaks`` are those that the
    receivers' visibilities belong to; ``report`` is the JSON report;
    ``reflections`` only where they were asked for."""

    image_sh: Array | None
    receivers: tuple[ReceiverResult, ...]
    report: dict[str, Any]
    peaks: tuple[Peak, ...] = ()
    atlases: tuple[Atlas, ...] = ()
    reflections: Reflections | None = None


def write_results(results: Results, folder: Path) -> None:
    """Write ``results`` into ``folder``: under another name first, so they are whole or absent."""
    unfinished = folder / f"{RESULTS}.tmp"
    unfinished.mkdir()
    if results.image_sh is not None:
        np.save(unfinished / "light.npy", results.image_sh)
    shapes = {
        name: write_all(unfinished / f"{name}.npy", [_some(r, name) for r in results.receivers])
        for name in RESULT_ARRAYS
    }
    uvs = [r.in_atlas.uvs for r in results.receivers if r.in_atlas is not None]
    shapes["uvs"] = write_all(unfinished / "uvs.npy", uvs)
    stamp = {"prtBaker": str(results.report.get("job_hash", ""))}
    for i, atlas in enumerate(results.atlases):
        _write_atlas(atlas, unfinished, f"atlas_{i}", stamp)
        if atlas.direct is not None:
            _write_atlas(atlas.direct, unfinished, f"direct_{i}", stamp)
    report = {
        "names": [r.name for r in results.receivers],
        "shapes": shapes,
        "in_atlas": [-1 if r.in_atlas is None else r.in_atlas.atlas for r in results.receivers],
        "atlases": [_header(atlas) for atlas in results.atlases],
        "peaks": [asdict(peak) for peak in results.peaks],
        "report": results.report,
        "reflections": _write_reflections(results.reflections, unfinished),
    }
    (unfinished / "report.json").write_text(json.dumps(report), encoding="utf-8")
    unfinished.rename(folder / RESULTS)


def read_results(folder: Path) -> Results:
    """The results in ``folder``, loaded whole, all but the atlases."""
    done = folder / RESULTS
    values = json.loads((done / "report.json").read_text(encoding="utf-8"))
    receivers = tuple(_read_receivers(done, values))
    light = done / "light.npy"
    image_sh = np.load(light) if light.exists() else None
    peaks = tuple(map(Peak.of, values["peaks"]))
    atlases = tuple(_read_atlases(done, i, what) for i, what in enumerate(values["atlases"]))
    reflections = _read_reflections(values["reflections"], done)
    return Results(image_sh, receivers, values["report"], peaks, atlases, reflections)


def _write_atlas(atlas: Atlas, folder: Path, stem: str, stamp: dict[str, str]) -> None:
    from .files.atlases import write_tiles
    from .files.layers import write_layers, write_png16

    assert atlas.image is not None
    path = folder / f"{stem}.exr"
    write_tiles(path, atlas.image, atlas.names, half=atlas.half, metadata=stamp)
    if atlas.engine_images == "exr":
        write_layers(folder, stem, atlas.image, atlas.names, half=atlas.half, metadata=stamp)
    elif atlas.engine_images == "png":
        write_png16(folder, stem, atlas.image, atlas.names, metadata=stamp)


def _header(atlas: Atlas) -> dict[str, Any]:
    direct = None if atlas.direct is None else _header(atlas.direct)
    return {name: getattr(atlas, name) for name in HEADER} | {"direct": direct}


def _read_atlases(done: Path, i: int, header: dict[str, Any]) -> Atlas:
    atlas = _read_atlas(done / f"atlas_{i}.exr", header)
    if header["direct"] is None:
        return atlas
    return replace(atlas, direct=_read_atlas(done / f"direct_{i}.exr", header["direct"]))


def _read_atlas(path: Path, header: dict[str, Any]) -> Atlas:
    beside = [*path.parent.glob(f"{path.stem}_*"), *path.parent.glob(f"{path.stem}.json")]
    size, names, margin, half = (header[name] for name in HEADER)
    return Atlas(size, tuple(names), margin, half, path=path, files=tuple(sorted(beside)))


def _write_reflections(found: Reflections | None, folder: Path) -> dict[str, Any] | None:
    if found is None:
        return None
    from .files.images import write_rgba

    assert found.image is not None
    write_rgba(str(folder / REFLECTIONS), found.image[::-1], half=True)
    return {"sheet": asdict(found.sheet), "peaks": [asdict(peak) for peak in found.peaks]}


def _read_reflections(values: dict[str, Any] | None, folder: Path) -> Reflections | None:
    if values is None:
        return None
    from .specular.sheet import Sheet

    return Reflections(
        Sheet.of(values["sheet"]),
        tuple(map(Peak.of, values["peaks"])),
        path=folder / REFLECTIONS,
    )


def _some(result: ReceiverResult, name: str) -> Array:
    """What is left of an array of ``result``."""
    step = 1 if result.in_atlas is None else 1 + len(result.transfer) // SOME
    array: Array = getattr(result, name)[::step]
    return array


def _read_receivers(done: Path, values: dict[str, Any]) -> Iterator[ReceiverResult]:
    left = {
        name: iter(read_all(done / f"{name}.npy", its)) for name, its in values["shapes"].items()
    }
    for name, atlas in zip(values["names"], values["in_atlas"], strict=True):
        arrays = {array: next(left[array]) for array in RESULT_ARRAYS}
        in_atlas = InAtlas(atlas, next(left["uvs"])) if atlas >= 0 else None
        yield ReceiverResult(name, **arrays, in_atlas=in_atlas)
