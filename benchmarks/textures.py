"""Textures: their error over the surface, the rays they take and their seams, against tracing every
texel.

Relative RMS of the transfer at random places of the surface, read bilinearly as a GPU does it,
against a reference with many rays.  A thousand places tell neither the RMS of a scan, where one in
some ten thousand lies in a crack or on a fold within a texel and may make two thirds of all squared
errors, nor a 99.9 % quantile, which is then one place; what a thousand show is told too, as the
median and the worst of the thousands that the places were drawn in.  Jumps are those of bilinear
reads at random places of seams, over the same figure of the steps from texel to texel inside of
charts.  Places inside of other things, which nobody sees, don't count.  Prints a table in Markdown;
``--pictures`` looks at it.
"""

import argparse
import struct
import sys
import time
import zlib
from collections.abc import Callable, Generator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from prt_baker.addon.prt.atlas.unwrap import unwrap
from prt_baker.addon.prt.job import Receiver, Settings
from prt_baker.addon.prt.steps import value_of
from prt_baker.addon.prt.surface.points import Points, Surface, element_triangles
from prt_baker.addon.prt.surface.samples import Places, random_places, starts
from prt_baker.addon.prt.texture.cover import barycentric, cover
from prt_baker.addon.prt.texture.edges import edges_of
from prt_baker.addon.prt.texture.fill import grow, push_pull
from prt_baker.addon.prt.texture.places import Mesh, pilot_points
from prt_baker.addon.prt.texture.refine import Grid
from prt_baker.addon.prt.texture.sampling import bilinear, footprint
from prt_baker.addon.prt.texture.solver import RINGS, Texels, solve
from prt_baker.addon.prt.tracing.buried import buried
from prt_baker.addon.prt.tracing.rays import occlusion
from prt_baker.addon.prt.tracing.tolerance import effort
from prt_baker.addon.prt.tracing.transfer import Shortcuts, trace_all

sys.path.insert(0, str(Path(__file__).parents[1] / "tests" / "engine"))
import rooms
import shapes

Array = np.ndarray
HEADER = """| scene | places | texels | rays a texel | rays, of every texel's | s \
| RMS error (every texel) | 90 % (every) | 99.9 % (every) | RMS of a thousand, median (every) \
| worst (every) | estimated | jump at seams, 99.9 % | largest |
|---|---|---|---|---|---|---|---|---|---|---|---|---|---|"""
FEW = 1000  # places: so many show the error, but for what is rare


@dataclass(frozen=True)
class Scene:
    """A receiver, its ``uvs``, and the vertices and triangles of all that casts shadows; from
    where it is looked at, and to where."""

    receiver: Receiver
    uvs: Array
    vertices: Array
    triangles: Array
    views: tuple[tuple[tuple[float, float, float], tuple[float, float, float]], ...]


def room(size: int) -> Scene:
    """The room with a window, a partition, an open door and furniture."""
    receiver, vertices, triangles = rooms.room()
    views = (
        ((3.3, 0.4, 1.7), (1.4, 2.6, 0.6)),
        ((5.7, 0.4, 1.8), (3.9, 2.4, 0.4)),
        ((2.6, 1.6, 0.9), (3.6, 3.3, 0.3)),
    )
    return Scene(receiver, rooms.planar_charts(receiver, size), vertices, triangles, views)


def snowden(size: int) -> Scene:
    """The scanned bust of npm's ``snowden`` on a plane."""
    import scenes

    scene = scenes.snowden()
    receiver = scene.centred.receivers[0]
    uvs = value_of(unwrap((receiver,), size=size, density=0, padding=4, threads=2)).uvs[0]
    everything = shapes.join((receiver.vertices, receiver.triangles), scene.others)
    views = (((0.6, -2.2, 1.5), (0.6, 0.5, 1.1)), ((2.4, -0.9, 1.7), (0.6, 0.5, 1.2)))
    return Scene(receiver, uvs, *everything, views)


SCENES: dict[str, Callable[[int], Scene]] = {"room": room, "snowden": snowden}


class Bench:
    """A scene in an atlas of ``size``², with the truth at ``places`` of its surface."""

    def __init__(self, scene: Scene, size: int, places: int, rays: int) -> None:
        self.scene, self.size, receiver = scene, size, scene.receiver
        self.sky = occlusion(scene.vertices, scene.triangles)
        self.mesh = Mesh.of(receiver, scene.uvs, size)
        self.index, self.on, _ = value_of(cover(self.mesh.layout, self.mesh.surface.solid))
        self.edges = edges_of(receiver, self.mesh.surface, self.mesh.layout)
        at = random_places(Surface.of(receiver).areas, places, 1)
        found = starts(self.mesh.surface, element_triangles(receiver), receiver.normals, at)
        where = tuple(values.astype(np.float32) for values in found)
        truth = self.trace(*where, rays, 101)
        seen = ~buried(*where, truth, self.sky)
        corners = scene.uvs[receiver.triangle_corners[at.triangles]].astype(np.float64)
        self.uvs = np.einsum("pk,pkc->pc", at.barycentric, corners)[seen]
        self.truth = truth[seen]
        self.few = np.flatnonzero(seen) // FEW

    def trace(self, origins: Array, normals: Array, rays: int, seed: int = 0) -> Array:
        """Transfer (P, 9) at ``origins`` (P, 3)."""
        out = np.empty((len(origins), 9), np.float32)
        where = Points(origins, normals, np.empty(0, np.int32))
        value_of(trace_all(where, self.sky, Settings(rays=rays, seed=seed), out))
        return out

    def solve(self, rays: int, tolerance: float) -> tuple[Texels, int]:
        """The bake, with ``rays`` or as many as the ``tolerance`` takes, and how many these are."""
        settings = Settings(rays=rays, tolerance=tolerance)
        its = value_of(effort(pilot_points(self.scene.receiver), self.sky, settings, Shortcuts()))

        def trace(origins: Array, normals: Array, count: int) -> Generator[int, None, Array]:
            yield 0
            values = self.trace(origins, normals, count)
            yield len(origins) * count
            return values

        receiver, uvs = self.scene.receiver, self.scene.uvs
        steps = solve(
            receiver, uvs, self.size, trace, self.sky, settings, rays=its.rays, noise=its.noise
        )
        return value_of(steps), its.rays

    def every_texel(self, rays: int) -> Array:
        """An image of which every texel was traced, buried ones filled alike; but of texels that no
        place reads only those from which such ones are filled."""
        read = np.zeros(self.size**2, bool)
        read[footprint(self.uvs, self.size)[0]] = True
        square = read.reshape(self.size, self.size)
        for _ in range(RINGS):
            square = near(square)
        mine = square.reshape(-1)[self.index]
        index, on = self.index[mine], self.on[mine]
        origins, normals = self.mesh.starts(self.mesh.places(index, on, np.zeros(2)))
        values = self.trace(origins, normals, rays)
        known = ~buried(origins, normals, values, self.sky)
        grow(Grid.of(self.size, index, self.edges.chart[on]), values, known, RINGS)
        return self.image(index[known], values[known])

    def image(self, index: Array, values: Array) -> Array:
        """The atlas (N, N, 9), filled."""
        flat = np.zeros((self.size**2, values.shape[1]), np.float32)
        known = np.zeros(self.size**2, bool)
        flat[index], known[index] = values, True
        image = flat.reshape(self.size, self.size, -1)
        value_of(push_pull(image, known.reshape(self.size, self.size)))
        return image

    def errors(self, image: Array) -> Array:
        """Relative errors at the places: RMS, 90 % and 99.9 % quantiles, and the median and the
        worst of the RMS of each thousand of those drawn."""
        squares = np.square(bilinear(image, self.uvs) - self.truth).mean(axis=1)
        squares = squares / np.mean(self.truth.astype(np.float64) ** 2)
        counts = np.bincount(self.few)
        few = np.bincount(self.few, squares)[counts > 0] / counts[counts > 0]
        found = [squares.mean(), *np.quantile(squares, (0.9, 0.999)), np.median(few), few.max()]
        return np.sqrt(found)

    def jumps(self, texels: Texels, image: Array) -> tuple[float, float] | None:
        """The 99.9 % quantile and the largest of the jumps at 10,000 places of seams, over those of
        the steps inside of charts; None without seams."""
        if not len(self.edges.seams):
            return None
        sides = self.seam_places(10000)
        corners = self.mesh.layout.corners
        where = (np.einsum("pk,pkc->pc", s.barycentric, corners[s.triangles]) for s in sides)
        reads = [bilinear(image, (places + 0.5) / self.size) for places in where]
        jump = np.sqrt(np.square(reads[0] - reads[1]).mean(axis=1))
        jump = jump[self.seen(sides[0]) | self.seen(sides[1])]
        regions = np.full(self.size**2, -1)
        regions[self.index] = self.edges.region[self.on]
        grid = Grid.of(self.size, texels.index, regions[texels.index])
        right = grid.neighbours(np.arange(len(texels.index)), [(0, 1)])[:, 0]
        steps = texels.values[right[right >= 0]] - texels.values[right >= 0]
        step = np.sqrt(np.square(steps).mean(axis=1))
        return (
            float(np.quantile(jump, 0.999) / np.quantile(step, 0.999)),
            float(jump.max() / step.max()),
        )

    def seam_places(self, count: int) -> tuple[Places, Places]:
        """Random places along the seams, by length, on the triangles of both sides."""
        random, seams = np.random.default_rng(4), self.edges.seams
        lengths = np.linalg.norm(seams[:, 0, 1] - seams[:, 0, 0], axis=1)
        chosen = random.choice(len(seams), count, p=lengths / lengths.sum())
        ends, along = seams[chosen], random.random((count, 1, 1))
        places = ends[:, :, 0] + along * (ends[:, :, 1] - ends[:, :, 0])
        here, there = (
            Places(t, barycentric(self.mesh.layout.corners[t], places[:, k]))
            for k, t in enumerate(self.edges.beside[chosen].T)
        )
        return here, there

    def seen(self, at: Places) -> Array:
        """Which of the places ``at`` do not lie inside of other things."""
        inside = np.maximum(at.barycentric, 0.05)  # not at an edge, where rays may slip
        nearby = Places(at.triangles, inside / inside.sum(axis=1, keepdims=True))
        where = self.mesh.starts(nearby)
        return ~buried(*where, self.trace(*where, 256), self.sky)


def row(name: str, bench: Bench, rays: int, tolerance: float, folder: Path | None) -> str:
    """One line of the table."""
    start = time.perf_counter()
    texels, rays = bench.solve(rays, tolerance)
    seconds = time.perf_counter() - start
    image = bench.image(texels.index, texels.values)
    if folder:
        for k, view in enumerate(bench.scene.views):
            save(folder / f"textures-{name}-{k}.png", picture(bench, image, *view))
    ours, every = bench.errors(image), bench.errors(bench.every_texel(rays))
    share = texels.entry["rays"] / (rays * len(bench.index))
    pairs = [f"{a:.2%} ({b:.2%})" for a, b in zip(ours, every, strict=True)]
    jumps = bench.jumps(texels, image)
    at_seams = ["", ""] if jumps is None else [f"{jump:.2f}" for jump in jumps]
    estimated = f"{texels.entry['surface_error']:.2%}"
    counts = [f"{len(bench.truth):,}", f"{len(texels.index):,}", f"{rays:,}", f"{share:.1%}"]
    cells = [name, *counts, f"{seconds:.0f}", *pairs, estimated, *at_seams]
    return "| " + " | ".join(cells) + " |"


def near(chosen: Array) -> Array:
    """The texels (N, N) that are ``chosen`` (N, N) or beside such, corners included."""
    wide = np.pad(chosen, 1)
    rows = wide[:-2] | wide[1:-1] | wide[2:]
    return np.asarray(rows[:, :-2] | rows[:, 1:-1] | rows[:, 2:])


def picture(bench: Bench, image: Array, eye: Any, to: Any) -> Array:
    """What is seen from ``eye`` under a white sky (480, 720, 3), 0 to 1: the mean transfer."""
    from embreex import rtcore_scene
    from embreex.mesh_construction import TriangleMesh

    receiver, height, width = bench.scene.receiver, 480, 720
    scene = rtcore_scene.EmbreeScene(robust=True)
    TriangleMesh(scene, receiver.vertices.astype(np.float32), receiver.triangles)
    ahead = np.subtract(to, eye) / np.linalg.norm(np.subtract(to, eye))
    right = np.cross(ahead, (0, 0, 1)) / np.linalg.norm(np.cross(ahead, (0, 0, 1)))
    x, y = np.meshgrid(np.linspace(-1, 1, width), np.linspace(1, -1, height) * height / width)
    away = x[..., None] * right + y[..., None] * np.cross(right, ahead)
    directions = (ahead + 0.75 * away).reshape(-1, 3).astype(np.float32)
    origins = np.broadcast_to(np.asarray(eye, np.float32), directions.shape).copy()
    hits = scene.run(origins, directions, query="INTERSECT", output=True)
    met = np.flatnonzero(hits["primID"] >= 0)
    u, v = np.asarray(hits["u"])[met], np.asarray(hits["v"])[met]
    corners = bench.scene.uvs[receiver.triangle_corners[np.asarray(hits["primID"])[met]]]
    uvs = np.einsum("pk,pkc->pc", np.stack([1 - u - v, u, v], axis=1), corners)
    shown = np.zeros(len(directions))
    shown[met] = bilinear(image, uvs)[:, 0]
    white = np.quantile(shown[met], 0.97)
    return (np.clip(shown / white, 0, 1) ** (1 / 2.2)).reshape(height, width)


def save(path: Path, grey: Array) -> None:
    """``grey`` (H, W), 0 to 1, as a PNG."""
    pixels = np.rint(255 * grey).astype(np.uint8)
    lines = b"".join(b"\0" + line.tobytes() for line in pixels)
    header = struct.pack(">IIBBBBB", grey.shape[1], grey.shape[0], 8, 0, 0, 0, 0)

    def chunk(kind: bytes, data: bytes) -> bytes:
        return (
            struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))
        )

    parts = [(b"IHDR", header), (b"IDAT", zlib.compress(lines, 9)), (b"IEND", b"")]
    path.write_bytes(b"\x89PNG\r\n\x1a\n" + b"".join(chunk(*part) for part in parts))


def main() -> None:
    """A row for each scene."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--scene", choices=SCENES, action="append")
    parser.add_argument("--size", type=int, default=1024)
    parser.add_argument("--rays", type=int, default=256)
    parser.add_argument("--tolerance", type=float, default=0.01, help="0: as many rays as given")
    parser.add_argument("--places", type=int, default=20000)
    parser.add_argument("--reference", type=int, default=16384, help="rays a place")
    parser.add_argument("--pictures", type=Path, help="folder to draw what is seen into")
    given = parser.parse_args()
    print(HEADER)
    for name in given.scene or SCENES:
        bench = Bench(SCENES[name](given.size), given.size, given.places, given.reference)
        print(row(name, bench, given.rays, given.tolerance, given.pictures), flush=True)


if __name__ == "__main__":
    main()
