"""A job: everything that decides a bake, as a folder of plain arrays and one settings file.

``write`` and ``read`` are inverse; ``content_hash`` names the result, which comes back in a folder
of its own (``results.py``).

    settings.json           kind, settings, light, names and domains of the receivers, the centre
    occluder_vertices.npy   (V, 3) float32, world axes, ``centre`` subtracted in float64
    occluder_triangles.npy  (F, 3) int32
    occluder_starts.npy     (O + 1,) int64, see ``Job``
    occluder_albedo.npy     (F, 3, 3) float32, where light bounces
    vertices.npy ...        the arrays of all receivers, see ``Receiver``, one receiver's after
                            the other's, flat: ``shapes`` in the settings tell them apart; the
                            vertices are float32 with ``centre`` subtracted
    image.npy               the pixels of a world that is no file, (H, W, 3) float32
    progress.jsonl          one line a step, see ``Progress``
    results/                see ``results.py``
"""

import hashlib
import json
from collections.abc import Iterator, Mapping
from dataclasses import asdict, dataclass, field, fields
from math import ceil, log2
from pathlib import Path
from typing import Any, Literal

import numpy as np
import numpy.typing as npt

from .arrays import Shape, read_all, write_all
from .digests import add_array, add_files

VERSION = 1

Array = npt.NDArray[Any]
Domain = Literal["POINT", "CORNER"]
Kind = Literal["bake", "light", "verify"]
Carrier = Literal["vertex", "texture", "auto"]
EngineImages = Literal["", "exr", "png"]
Vector = tuple[float, float, float]
IDENTITY = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))

ALL = -1  # bounces
LIGHT_ORDER = 5  # the light is always projected to this order: a bake of a lower one reads its head


@dataclass(frozen=True)
class Settings:
    """What the artist chose.

    ``rays`` a point, unless ``tolerance``, a relative error of the transfer, is given: then as many
    as that takes.  ``fit`` lets values at vertices be fitted to samples inside the triangles.
    ``residual`` stores what the light's order leaves out, for ``turns`` turns of the world about Z,
    found with ``map_rays`` more candidates a point.  Up to ``peaks`` suns and lamps are cut out of
    the map.  ``final_light`` says that the light will not change, so that what it doesn't show need
    not be stored.  ``bounces`` of light from surface to surface are in the transfer: 0 is shadows
    alone, ALL goes on until the added light falls below the tolerance.  ``keep_direct`` stores what
    there is without them too, and changes nothing else.  What each point sees is stored too, in
    ``visibility_order`` bands, unless that is 0.  ``reflections`` prepares the light for shiny
    surfaces, and changes nothing that is traced.  ``threads`` 0 means every core and changes no
    result; nor does ``cache``, a folder that keeps what was traced, "" for none.

    An atlas has ``resolution`` texels a side, unless ``texel_density``, texels a metre, is given:
    then as many as that takes.  ``shared_atlas`` puts all receivers into one, else each has its
    own.  Charts stay apart up to mip level ``padding_mip``.  ``half`` stores half floats.
    ``engine_images`` writes each atlas once more, an image for every four numbers of a texel.
    """

    order: int = 3
    rays: int = 256
    tolerance: float = 0.0
    fit: bool = True
    residual: bool = True
    map_rays: int = 258
    turns: int = 1
    peaks: int = 0
    final_light: bool = False
    bounces: int = 0
    keep_direct: bool = False
    visibility_order: int = 0
    reflections: bool = False
    resolution: int = 1024
    texel_density: float = 0.0
    shared_atlas: bool = True
    padding_mip: int = 2
    half: bool = False
    engine_images: EngineImages = ""
    cache: str = ""
    seed: int = 0
    threads: int = 0
    verify_points: int = 0
    verify_rays: int = 16384

    @property
    def verify_work(self) -> float:
        """What measuring one receiver is, in points."""
        return 2 * self.verify_points * self.verify_rays / self.rays


@dataclass(frozen=True)
class LightSource:
    """Distant light: ``strength * image(rotation @ direction)``, or ``strength`` alone.

    ``strength`` is radiance (W sr⁻¹ m⁻², linear Rec.709) where there is no image and a factor where
    there is one.  ``image`` is a lat-long .exr or .hdr on disk; ``pixels`` (H, W, 3) float32, top
    row first, stands in for one that is in memory.  ``rotation`` takes world directions to the
    image's.  With ``may_be_cubemap`` a picture of a cross's or strip's shape, or a folder with the
    faces px, nx, py, ny, pz and nz, is a cubemap; Blender's own worlds never are.  ``title`` is
    what the artist calls an image whose path says nothing to him.
    """

    strength: Vector = (1.0, 1.0, 1.0)
    image: str | None = None
    pixels: Array | None = field(default=None, compare=False)
    rotation: tuple[Vector, Vector, Vector] = IDENTITY
    may_be_cubemap: bool = False
    title: str = ""


@dataclass(frozen=True)
class Receiver:
    """A mesh that receives light, evaluated, in world space.

    ``vertices`` (V, 3) float64, ``triangles`` (F, 3) int32 into the vertices, wound so that the
    geometric normal points out (mirrored objects too), ``triangle_corners`` (F, 3) int32 into the
    corners, ``corner_vertices`` (C,) int32, ``normals`` float32 unit shading normals: (V, 3) where
    ``domain`` is POINT, (C, 3) where it is CORNER.  ``transfer`` (E, channels, n²) and
    ``residual`` (E, turns, 3) and ``visibility_sh`` (E, v²) float32, one for each element of the
    domain, are given for a job that verifies a bake; where that is in a texture they are what is
    shown at the ``places``, rows of (triangle, barycentric coordinates) (E, 4) float64.

    The values lie where ``carrier`` says: at the elements, in an atlas, or where a prediction says
    that they are better off.  Receivers of one ``group``, which share materials, share an atlas.
    ``uvs`` (C, 2) float32, one a corner, are kept where they can be: without a ``uv_key`` they are
    the artist's, and with one those of an earlier bake, for the atlas that the key names.
    """

    name: str
    domain: Domain
    vertices: Array
    triangles: Array
    triangle_corners: Array
    corner_vertices: Array
    normals: Array
    transfer: Array | None = None
    residual: Array | None = None
    visibility_sh: Array | None = None
    carrier: Carrier = "vertex"
    group: int = -1
    uvs: Array | None = None
    uv_key: str = ""
    places: Array | None = None


@dataclass(frozen=True)
class Job:
    """All that a run of the engine reads; ``occluder_vertices`` (V, 3) float64 in world space.

    Occluder k, an object or an instance, is the triangles from ``occluder_starts[k]`` up to
    ``occluder_starts[k + 1]``, and shares no vertex with another one.  ``occluder_starts`` (O + 1,)
    int64; by default all is one part, or none where there are no triangles.
    ``occluder_albedo`` (F, 3, 3) float32, linear Rec.709, 0 to 1: the diffuse reflectance at the
    corners of each occluder triangle, without which nothing bounces.
    """

    kind: Kind = "bake"
    settings: Settings = Settings()
    light: LightSource | None = None
    receivers: tuple[Receiver, ...] = ()
    occluder_vertices: Array = field(default_factory=lambda: np.empty((0, 3)))
    occluder_triangles: Array = field(default_factory=lambda: np.empty((0, 3), np.int32))
    repairs: dict[str, int] = field(default_factory=dict)
    occluder_starts: Array = field(default_factory=lambda: np.empty(0, np.int64))
    occluder_albedo: Array = field(default_factory=lambda: np.empty((0, 3, 3), np.float32))

    def __post_init__(self) -> None:
        """One part where none are given; ValueError where the parts are not of these triangles."""
        count = len(self.occluder_triangles)
        if not len(self.occluder_starts):
            starts = np.array([0, count] if count else [0], np.int64)
            object.__setattr__(self, "occluder_starts", starts)
        if self.occluder_starts[0] != 0 or self.occluder_starts[-1] != count:
            raise ValueError("occluder_starts do not cover the triangles")
        if len(self.occluder_albedo) != count and (self.bounces or len(self.occluder_albedo)):
            raise ValueError("occluder_albedo is not that of the triangles")

    @property
    def bounces(self) -> int:
        """As in the settings; 0 where there is nothing that light could bounce off."""
        return self.settings.bounces if len(self.occluder_triangles) else 0


@dataclass(frozen=True)
class Progress:
    """Where a run is: ``fraction`` of the whole work done, rays cast so far, seconds so far."""

    phase: str
    fraction: float
    rays: int = 0
    seconds: float = 0.0

    @property
    def seconds_left(self) -> float | None:
        """By the rate so far; None until there is one."""
        if self.fraction < 0.02:
            return None
        return self.seconds * (1 - self.fraction) / self.fraction


@dataclass(frozen=True)
class Peak:
    """A sun or lamp cut out of the map, as it stood in the world when it was baked: ``direction``
    to it, ``irradiance`` (W m⁻²) of a surface that faces it, and its ``angular_radius``."""

    direction: Vector
    irradiance: Vector
    angular_radius: float

    @classmethod
    def of(cls, values: Mapping[str, Any]) -> "Peak":
        """The peak whose fields are ``values``, as files keep them."""
        direction, irradiance = tuple(values["direction"]), tuple(values["irradiance"])
        return cls(direction, irradiance, values["angular_radius"])


SETTINGS = "settings.json"
RECEIVER_ARRAYS = ("vertices", "triangles", "triangle_corners", "corner_vertices", "normals")
SHOWN = ("transfer", "residual", "visibility_sh", "uvs", "places")
HEADER = ("name", "domain", "carrier", "group", "uv_key")


def content_hash(job: Job) -> str:
    """Names the result: equal jobs give equal bits, whatever ``threads`` is."""
    digest = hashlib.blake2b(digest_size=16)
    without = ("threads", "cache")
    settings = {k: v for k, v in asdict(job.settings).items() if k not in without}
    receivers = [[getattr(r, name) for name in HEADER] for r in job.receivers]
    digest.update(json.dumps((VERSION, job.kind, settings, receivers), sort_keys=True).encode())
    digest.update(light_digest(job.light))
    for name, array in _arrays_of_all(job, None):
        add_array(digest, name, array)
    for name, arrays in _arrays_of_each(job, None):
        for array in arrays:
            add_array(digest, name, array)
    return digest.hexdigest()


def light_digest(light: LightSource | None) -> bytes:
    """Names what ``light`` shows, wherever its picture lies and whatever it is called."""
    digest = hashlib.blake2b(digest_size=32)
    header = _light_header(light) or {}
    image, _ = header.pop("image", None), header.pop("title", None)
    digest.update(json.dumps(header, sort_keys=True).encode())
    add_files(digest, image)
    if light is not None and light.pixels is not None:
        add_array(digest, "image", light.pixels)
    return digest.digest()


def write(job: Job, folder: Path) -> None:
    """Write ``job`` into an existing, empty ``folder``, the settings last."""
    centre = _centre(job)
    for name, array in _arrays_of_all(job, centre):
        np.save(folder / f"{name}.npy", array)
    shapes = {
        name: write_all(folder / f"{name}.npy", list(arrays))
        for name, arrays in _arrays_of_each(job, centre)
    }
    if job.light is not None and job.light.pixels is not None:
        np.save(folder / "image.npy", job.light.pixels)
    receivers = [
        {name: getattr(r, name) for name in HEADER} | {"shown": [n for n in SHOWN if _has(r, n)]}
        for r in job.receivers
    ]
    values = {
        "version": VERSION,
        "kind": job.kind,
        "settings": asdict(job.settings),
        "light": _light_header(job.light),
        "receivers": receivers,
        "shapes": shapes,
        "repairs": job.repairs,
        "centre": centre.tolist(),
    }
    unfinished = folder / "settings.tmp"
    unfinished.write_text(json.dumps(values), encoding="utf-8")
    unfinished.rename(folder / SETTINGS)


def is_written(folder: Path) -> bool:
    """Whether all of a job is in ``folder``."""
    return (folder / SETTINGS).exists()


def read(folder: Path) -> Job:
    """The job of ``folder``, its arrays memory-mapped and centred."""
    values = json.loads((folder / SETTINGS).read_text(encoding="utf-8"))
    return Job(
        kind=values["kind"],
        settings=Settings(**values["settings"]),
        light=_read_light(values["light"], folder),
        receivers=tuple(_read_receivers(folder, values["receivers"], values["shapes"])),
        occluder_vertices=_load(folder, "occluder_vertices"),
        occluder_triangles=_load(folder, "occluder_triangles"),
        repairs=values["repairs"],
        occluder_starts=_load(folder, "occluder_starts"),
        **_albedo(folder),
    )


def _centre(job: Job) -> Array:
    """The middle of the receivers' bounds, as float32 is finest where we bake, on a grid of powers
    of two as coarse as they are large: so a receiver that moves a little leaves the arrays of all
    others as they were, and a scene about the origin stays where it is."""
    bounds = [e for r in job.receivers if len(r.vertices) for e in _bounds(r.vertices)]
    if not bounds:
        return np.zeros(3)
    low, high = _bounds(np.array(bounds))
    extent = max(float((high - low).max()), float(np.finfo(np.float32).tiny))
    step = 2.0 ** (ceil(log2(extent)) + 1)
    return np.asarray(np.rint(0.5 * (low + high) / step) * step + 0.0)


def _bounds(vertices: Array) -> tuple[Array, Array]:
    return vertices.min(axis=0), vertices.max(axis=0)


def _arrays_of_all(job: Job, centre: Array | None) -> Iterator[tuple[str, Array]]:
    yield "occluder_vertices", _centred(job.occluder_vertices, centre)
    yield "occluder_triangles", np.asarray(job.occluder_triangles, np.int32)
    yield "occluder_starts", np.asarray(job.occluder_starts, np.int64)
    if len(job.occluder_albedo):
        yield "occluder_albedo", np.asarray(job.occluder_albedo, np.float32)


def _arrays_of_each(job: Job, centre: Array | None) -> Iterator[tuple[str, Iterator[Array]]]:
    """Of each name the arrays of the receivers that have it."""
    for name in (*RECEIVER_ARRAYS, *SHOWN):
        arrays = (getattr(r, name) for r in job.receivers if _has(r, name))
        yield name, (_centred(a, centre) if name == "vertices" else a for a in arrays)


def _centred(vertices: Array, centre: Array | None) -> Array:
    """float32 of differences in float64, with no float64 array between."""
    if centre is None:
        return vertices
    centred = np.empty(vertices.shape, np.float32)
    np.subtract(vertices, centre, out=centred, dtype=np.float64, casting="same_kind")
    return centred


def _light_header(light: LightSource | None) -> dict[str, Any] | None:
    if light is None:
        return None
    return {f.name: getattr(light, f.name) for f in fields(light) if f.name != "pixels"}


def _albedo(folder: Path) -> dict[str, Array]:
    name = "occluder_albedo"
    return {name: _load(folder, name)} if (folder / f"{name}.npy").exists() else {}


def _read_light(values: dict[str, Any] | None, folder: Path) -> LightSource | None:
    if values is None:
        return None
    pixels = _load(folder, "image") if (folder / "image.npy").exists() else None
    rotation = tuple(tuple(row) for row in values["rotation"])
    strength = tuple(values["strength"])
    rest = {"may_be_cubemap": values["may_be_cubemap"], "title": values["title"]}
    return LightSource(strength, values["image"], pixels, rotation, **rest)  # type: ignore[arg-type]


def _read_receivers(
    folder: Path, headers: list[dict[str, Any]], shapes: dict[str, list[Shape]]
) -> Iterator[Receiver]:
    left = {
        name: iter(read_all(folder / f"{name}.npy", its, mapped=True))
        for name, its in shapes.items()
    }
    for header in headers:
        names = (*RECEIVER_ARRAYS, *header["shown"])
        arrays: dict[str, Any] = {name: next(left[name]) for name in names}
        yield Receiver(**{name: header[name] for name in HEADER}, **arrays)


def _has(receiver: Receiver, name: str) -> bool:
    return getattr(receiver, name) is not None


def _load(folder: Path, name: str) -> Array:
    path = folder / f"{name}.npy"
    shape, dtype = _npy_shape(path)
    return np.empty(shape, dtype) if 0 in shape else np.load(path, mmap_mode="r")


def _npy_shape(path: Path) -> tuple[tuple[int, ...], np.dtype[Any]]:
    with path.open("rb") as file:
        np.lib.format.read_magic(file)
        shape, _, dtype = np.lib.format.read_array_header_1_0(file)
    return shape, dtype
