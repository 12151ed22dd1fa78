"""The error over the surface at equal rays: values fitted to samples inside the triangles against
values traced at the points.

Relative RMS of the transfer at random places of the surface, interpolated as a renderer does it,
against a reference with many rays; places inside of other things, which nobody sees, don't count.
Every ray counts, the pilots' too.  Prints a table in Markdown.
"""

import argparse
import sys
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from prt_baker.addon.prt.job import Receiver, Settings
from prt_baker.addon.prt.steps import value_of
from prt_baker.addon.prt.surface.points import Points, Surface, distinct_points, element_triangles
from prt_baker.addon.prt.surface.samples import random_places, starts
from prt_baker.addon.prt.tracing import tolerance, transfer
from prt_baker.addon.prt.tracing.buried import buried
from prt_baker.addon.prt.tracing.rays import occlusion
from prt_baker.addon.prt.vertex.solver import Solved, solve

sys.path.insert(0, str(Path(__file__).parents[1] / "tests" / "engine"))
import shapes
from test_vertices import folded_sheet

Scene = tuple[Receiver, np.ndarray, np.ndarray]
HEADER = """| scene | points | rays | points' error | fit's error | ratio | fit's rays | \
estimated (points, fit) | reference's own error |
|---|---|---|---|---|---|---|---|---|"""


def flat_boxes(count: int) -> Scene:
    """Boxes on a floor that is not baked, apart, their faces flat with ``count``² quads: shadows
    with edges on every side."""
    random = np.random.default_rng(0)
    box = shapes.box(1.0, count, inward=False)
    boxes = []
    for i in range(16):
        size = random.uniform((0.25, 0.25, 0.2), (0.55, 0.55, 1.0))
        place = np.array([i % 4 - 1.5, i // 4 - 1.5, 0]) * 0.75 + [0, 0, size[2] / 2 + 0.01]
        angle = random.uniform(0, 2 * np.pi)
        c, s = np.cos(angle), np.sin(angle)
        turn = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])
        boxes.append(((box[0] * size) @ turn.T + place, box[1]))
    everything = shapes.join(*boxes)
    floor = shapes.grid([-4, -4, 0], [8, 0, 0], [0, 8, 0], 2)
    return shapes.receiver(*everything), *shapes.join(everything, floor)


def suzanne(levels: int) -> Scene:
    """Blender's monkey, subdivided: three islands, whose eyes lie half inside of the head."""
    import bpy

    bpy.ops.wm.read_factory_settings(use_empty=True)
    bpy.ops.mesh.primitive_monkey_add()
    body = bpy.context.object
    body.modifiers.new("", "SUBSURF").levels = levels
    mesh = body.evaluated_get(bpy.context.evaluated_depsgraph_get()).to_mesh()
    mesh.calc_loop_triangles()
    vertices = np.array([v.co for v in mesh.vertices])
    triangles = np.array([t.vertices for t in mesh.loop_triangles])
    normals = np.array([v.normal for v in mesh.vertices])
    return shapes.receiver(vertices, triangles, normals), vertices, triangles


SCENES: dict[str, tuple[Callable[[], Scene], tuple[int, ...]]] = {
    "knot 600 x 24": (shapes.knot_scene, (64, 256, 1024)),
    "folded sheet 220²": (lambda: folded_sheet(220), (64, 256)),
    "folded sheet 80²": (lambda: folded_sheet(80), (64, 256, 1024)),
    "flat boxes, faces 16²": (lambda: flat_boxes(16), (64, 256, 1024)),
    "flat boxes, faces 8²": (lambda: flat_boxes(8), (64, 256, 1024)),
    "Suzanne, 2 levels": (lambda: suzanne(2), (64, 256, 1024)),
}


@dataclass
class Bench:
    """A scene with the truth at random places of its surface."""

    scene: Scene
    places: int
    rays: int

    def __post_init__(self) -> None:
        """Trace the truth twice, which tells its own error."""
        self.receiver, vertices, triangles = self.scene
        self.sky = occlusion(vertices, triangles)
        self.points = distinct_points(self.receiver)
        surface, rows = Surface.of(self.receiver), element_triangles(self.receiver)
        self.at = random_places(surface.areas, self.places, 1)
        self.corners = self.points.element_points[rows][self.at.triangles]
        found = starts(surface, rows, self.receiver.normals, self.at)
        where = tuple(values.astype(np.float32) for values in found)
        halves = [self.trace(*where, self.rays // 2, seed) for seed in (101, 102)]
        self.truth = np.mean(halves, axis=0)
        self.seen = ~buried(*where, self.truth, self.sky)
        self.own_error = 0.5 * transfer.relative_rms(*(half[self.seen] for half in halves))

    def trace(self, origins: np.ndarray, normals: np.ndarray, rays: int, seed: int = 0):  # noqa: ANN201
        """Transfer (P, 9) at ``origins`` (P, 3)."""
        out = np.empty((len(origins), 9), np.float32)
        where = Points(origins, normals, np.empty(0, np.int32))
        settings = Settings(rays=rays, seed=seed)
        value_of(transfer.trace_all(where, self.sky, settings, out))
        return out

    def noise(self, rays: int) -> float:
        """The estimated error of the points at ``rays``."""
        some = slice(0, None, max(1, len(self.points.origins) // 1024))
        origins, normals = self.points.origins[some], self.points.normals[some]
        few, many = (self.trace(origins, normals, n, n) for n in (rays // 4, rays))
        return tolerance.ERROR_OF_DIFFERENCE * transfer.relative_rms(few, many)

    def solve(self, rays: int, fit: bool, noise: float) -> tuple[Solved, int]:
        """The values of the points, and the rays that they took."""
        cast = 0

        def trace(origins: np.ndarray, normals: np.ndarray, count: int):  # noqa: ANN202
            nonlocal cast
            cast += len(origins) * count
            yield len(origins) * count
            return self.trace(origins, normals, count)

        settings = replace(Settings(), fit=fit, rays=rays)
        steps = solve(self.receiver, self.points, trace, self.sky, settings, rays=rays, noise=noise)
        return value_of(steps), cast

    def error(self, values: np.ndarray) -> float:
        """The relative RMS error of ``values`` (P, 9) of the points over the surface."""
        shown = np.einsum("pk,pkc->pc", self.at.barycentric, values[self.corners])
        return transfer.relative_rms(shown[self.seen], self.truth[self.seen])


def row(name: str, bench: Bench, rays: int) -> str:
    """One line of the table."""
    noise, count = bench.noise(rays), len(bench.points.origins)
    points, _ = bench.solve(rays, fit=False, noise=noise)
    fitted, cast = bench.solve(rays, fit=True, noise=noise)
    errors = bench.error(points.values), bench.error(fitted.values)
    estimates = (solved.entry["surface_error"] for solved in (points, fitted))
    return (
        f"| {name} | {count:,} | {rays} | {100 * errors[0]:.2f} % | {100 * errors[1]:.2f} % "
        f"| **{errors[0] / errors[1]:.2f}** | {cast / count / rays:.3f} "
        f"| {', '.join(f'{100 * e:.2f} %' for e in estimates)} | {100 * bench.own_error:.2f} % |"
    )


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--places", type=int, default=1000)
    parser.add_argument("--rays", type=int, default=16384, help="of the reference")
    parser.add_argument("--scene", default="", help="only scenes whose name has this")
    asked = parser.parse_args()
    print(HEADER)
    for name, (build, counts) in SCENES.items():
        if asked.scene in name:
            bench = Bench(build(), asked.places, asked.rays)
            for rays in counts:
                print(row(name, bench, rays), flush=True)


if __name__ == "__main__":
    main()
