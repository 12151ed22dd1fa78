"""The scenes of the benchmark, as the arrays that the engine and its competitors read."""

import gzip
import importlib.util
import sys
import tempfile
import zlib
from base64 import b64decode
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
from peers import Worker
from prt_baker.addon.prt import job as jobs
from prt_baker.addon.prt.surface.points import Points, distinct_points

sys.path.insert(0, str(Path(__file__).parents[1] / "tests" / "engine"))
import shapes

Array = np.ndarray
Mesh = tuple[Array, Array]  # vertices (V, 3), triangles (F, 3)

CACHE = Path(__file__).parents[1] / ".cache" / "bench"
NOTHING: Mesh = (np.empty((0, 3)), np.empty((0, 3), np.int32))


@dataclass(frozen=True)
class Scene:
    """Receivers, which are occluders too, and ``others``, which only cast shadows.

    ``is_fair_to_cycles`` where a vertex of the mesh is a sound place to start a ray from: Cycles
    bakes there, everybody else a little off it.
    """

    name: str
    title: str
    receivers: tuple[jobs.Receiver, ...]
    others: Mesh = NOTHING
    is_fair_to_cycles: bool = False

    def job(self, settings: jobs.Settings) -> jobs.Job:
        """The bake of this scene's transfer, in world coordinates."""
        meshes = [(r.vertices, r.triangles) for r in self.receivers]
        vertices, triangles = shapes.join(*meshes, self.others)
        white = jobs.LightSource()
        return jobs.Job("bake", settings, white, self.receivers, vertices, triangles)

    @cached_property
    def centred(self) -> jobs.Job:
        """The job as the engine reads it: float32 about the receivers' centre."""
        with tempfile.TemporaryDirectory() as folder:
            jobs.write(self.job(jobs.Settings()), Path(folder))
            return jobs.read(Path(folder))

    @cached_property
    def points(self) -> list[Points]:
        """The points that the engine traces, receiver by receiver, in centred coordinates."""
        return [distinct_points(receiver) for receiver in self.centred.receivers]

    @cached_property
    def origins(self) -> Array:
        """Where rays start (P, 3) float32, receiver after receiver."""
        return np.concatenate([p.origins for p in self.points])

    @cached_property
    def normals(self) -> Array:
        """Unit shading normals (P, 3) float32."""
        return np.concatenate([p.normals for p in self.points])


def smooth_normals(vertices: Array, triangles: Array) -> Array:
    """Unit vertex normals (V, 3): the triangles' weighted by their angle at the vertex."""
    corners = vertices[triangles].astype(np.float64)
    after = np.roll(corners, -1, axis=1) - corners
    before = np.roll(corners, 1, axis=1) - corners
    lengths = np.linalg.norm(after, axis=2) * np.linalg.norm(before, axis=2)
    cosine = np.einsum("fkc,fkc->fk", after, before) / np.maximum(lengths, 1e-300)
    angle = np.arccos(np.clip(cosine, -1, 1))
    facing = np.cross(after[:, 0], before[:, 0])
    facing /= np.maximum(np.linalg.norm(facing, axis=1, keepdims=True), 1e-300)
    normals = np.zeros((len(vertices), 3))
    for k in range(3):
        np.add.at(normals, triangles[:, k], angle[:, k, None] * facing)
    return normals / np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-300)


def smooth(vertices: Array, triangles: Array, name: str) -> jobs.Receiver:
    """A receiver with smooth normals."""
    return shapes.receiver(vertices, triangles, smooth_normals(vertices, triangles), name)


def elsewhere(module: str, function: str, *arguments: Any) -> Any:
    """The value of a ``function`` whose module needs bpy, which puts folders of its own into the
    path that later competitors' processes would start with."""
    worker = Worker(module)
    try:
        return worker.ask(function, *arguments)
    finally:
        worker.close()


def suzanne() -> Scene:
    """Blender's monkey, subdivided twice, alone."""
    vertices, triangles = elsewhere("scenes", "monkey")
    return Scene(
        "suzanne", "Suzanne", (smooth(vertices, triangles, "suzanne"),), is_fair_to_cycles=True
    )


def monkey() -> Mesh:
    """Its subdivided mesh out of Blender."""
    import bpy

    bpy.ops.wm.read_factory_settings(use_empty=True)
    bpy.ops.mesh.primitive_monkey_add()
    head = bpy.context.object
    head.modifiers.new("fine", "SUBSURF").levels = 2
    mesh = head.evaluated_get(bpy.context.evaluated_depsgraph_get()).to_mesh()
    mesh.calc_loop_triangles()
    vertices = np.empty((len(mesh.vertices), 3), np.float32)
    triangles = np.empty((len(mesh.loop_triangles), 3), np.int32)
    mesh.vertices.foreach_get("co", vertices.reshape(-1))
    mesh.loop_triangles.foreach_get("vertices", triangles.reshape(-1))
    return vertices, triangles


def knot(rows: int = 600, columns: int = 24) -> Scene:
    """The torus knot of ``rows * columns`` points over a floor and before a wall."""
    receiver, vertices, triangles = shapes.knot_scene(rows, columns)
    count = len(receiver.vertices)
    outside = triangles[(triangles >= count).all(axis=1)] - count
    others = (vertices[count:], outside)
    return Scene("knot", "torus knot, floor and wall", (receiver,), others, is_fair_to_cycles=True)


def cortex() -> Scene:
    """The left half of a cortex, deeply folded: fsaverage5, from the files of nilearn's wheel."""
    package = importlib.util.find_spec("nilearn")
    if package is None or package.origin is None:
        raise ModuleNotFoundError("nilearn")
    file = Path(package.origin).parent / "datasets" / "data" / "fsaverage5" / "pial_left.gii.gz"
    vertices, triangles = gifti(gzip.decompress(file.read_bytes()))
    # to units of ten centimetres, the left side's outside towards -x as it is
    receiver = smooth(vertices / 100, triangles, "cortex")
    return Scene("cortex", "cortex", (receiver,), is_fair_to_cycles=True)


def gifti(text: bytes) -> Mesh:
    """The two arrays of a GIFTI surface (base64 of zlib, little-endian)."""
    arrays = []
    for element in ElementTree.fromstring(text).iter("DataArray"):  # noqa: S314 - the wheel's file
        kind = {"NIFTI_TYPE_FLOAT32": "<f4", "NIFTI_TYPE_INT32": "<i4"}[element.attrib["DataType"]]
        data = element.find("Data")
        assert data is not None
        raw = zlib.decompress(b64decode(data.text or ""))
        arrays.append(np.frombuffer(raw, kind).reshape(-1, 3))
    vertices, triangles = arrays
    return vertices, triangles


def snowden() -> Scene:
    """The scanned bust of npm's ``snowden`` on a plane."""
    folder = CACHE / "snowden"
    folder.mkdir(parents=True, exist_ok=True)
    vertices, triangles = elsewhere("real_inputs", "snowden", folder)
    upright = (vertices[:, [0, 2, 1]] * (1, -1, 1)).astype(np.float64)
    upright = (upright - upright.min(axis=0)) / np.ptp(upright, axis=0).max() * 2
    floor = shapes.grid([-4, -4, 0], [8, 0, 0], [0, 8, 0], 1)
    return Scene("snowden", "snowden", (smooth(upright, triangles, "snowden"),), floor)


def city(boxes: int = 2000, quads: int = 3) -> Scene:
    """Boxes of many heights, turned a little, on a street plan; their ground is baked too."""
    random = np.random.default_rng(4)
    side = int(np.ceil(boxes**0.5))
    houses = []
    for i in range(boxes):
        middle = np.array([i % side, i // side, 0]) - [side / 2, side / 2, 0]
        width, depth = random.uniform(0.4, 0.8, 2)
        angle, height = random.normal(0, 0.1), random.gamma(3, 0.35) + 0.2
        houses.append(house(middle, (width, depth, height), angle, quads))
    walls = shapes.receiver(*shapes.join(*houses), name="houses")
    extent = side + 2
    corner = [-extent / 2, -extent / 2, 0]
    ground = shapes.grid(corner, [extent, 0, 0], [0, extent, 0], 64 * quads)
    receivers = (walls, smooth(*ground, "ground"))
    return Scene("city", f"city of {boxes:,} boxes", receivers)


def house(middle: Array, size: tuple[float, float, float], angle: float, quads: int) -> Mesh:
    """Four walls and a roof on the ground about ``middle``, sunk by a little."""
    width, depth, height = size
    c, s = np.cos(angle), np.sin(angle)
    along, across = width * np.array([c, s, 0]), depth * np.array([-s, c, 0])
    up, foot = np.array([0, 0, height + 0.05]), middle - 0.5 * (along + across) - [0, 0, 0.05]
    top, right, far = foot + up, foot + along, foot + across
    return shapes.join(
        shapes.grid(foot, along, up, quads),
        shapes.grid(right, across, up, quads),
        shapes.grid(right + across, -along, up, quads),
        shapes.grid(far, -across, up, quads),
        shapes.grid(top, along, across, quads),
    )


def field(quads: int = 1000) -> Scene:
    """A wide flat ground with a few things on it, all of them baked."""
    random = np.random.default_rng(9)
    things = []
    for i in range(12):
        place = [*random.uniform(-40, 40, 2), 0]
        shape, triangles = shapes.torus_knot(200, 16)[:2] if i % 3 else shapes.sphere(32, 64)[:2]
        stands = shape - [0, 0, shape[:, 2].min() - 0.1]
        things.append((stands * random.uniform(0.7, 2) + place, triangles))
    ground = shapes.grid([-50, -50, 0], [100, 0, 0], [0, 100, 0], quads)
    receivers = (smooth(*ground, "ground"), smooth(*shapes.join(*things), "things"))
    return Scene("field", "open field", receivers)


BUILDERS: dict[str, Callable[[], Scene]] = {
    "suzanne": suzanne,
    "knot": knot,
    "cortex": cortex,
    "snowden": snowden,
    "city": city,
    "field": field,
}
SMALL: dict[str, Callable[[], Scene]] = {
    **BUILDERS,
    "city": lambda: city(quads=1),
}
