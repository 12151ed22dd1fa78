"""What bounces cost: whole bakes with them beside the same without, taking turns in one run.

About 100,000 points at vertices, order 3, 256 rays; a well, the torus knot over a floor and before
a wall, which are not baked, and hills, of whose rays few meet anything.  A bake is the whole
run of the engine in its own process: start, job and results on disk, points, acceleration
structure, rays, fits.  Prints a table in Markdown: medians of the seconds, and of the ratios.
"""

import argparse
import statistics
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import scenes
from prt_baker.addon import engine
from prt_baker.addon.prt import job as jobs
from prt_baker.addon.prt.light import lat_long
from prt_baker.addon.prt.results import read_results
from prt_baker.addon.prt.surface.points import distinct_points
from prt_baker.addon.prt.tracing.hemisphere import RaysInWorld, frames, hemisphere_set
from prt_baker.addon.prt.tracing.rays import CLEAR, occlusion

sys.path.insert(0, str(Path(__file__).parents[1] / "tests" / "engine"))
import shapes

Albedos = Sequence[tuple[float, float, float]]

SOME = 1000  # points
GREY: Albedos = ((0.7, 0.7, 0.7),)
COLOURS: Albedos = ((0.75, 0.2, 0.1), (0.7, 0.7, 0.7))  # of the triangles, in turn
SETTINGS: dict[str, dict[str, bool]] = {
    "default": {},
    "no fit, no residual": {"fit": False, "residual": False},
}


def well(count: int = 140) -> jobs.Job:
    """A box of side 2, open at the top, of ``count`` squares along a side, seen from inside."""
    corner = [-1, -1, -1]
    sides = [shapes.grid(corner, [2, 0, 0], [0, 2, 0], count)]
    for start, along in (
        (corner, [0, 2, 0]),
        ([-1, 1, -1], [2, 0, 0]),
        ([1, 1, -1], [0, -2, 0]),
        ([1, -1, -1], [-2, 0, 0]),
    ):
        sides.append(shapes.grid(start, along, [0, 0, 2], count))
    vertices, triangles = shapes.join(*sides)
    return _job(shapes.receiver(vertices, triangles), vertices, triangles)


def knot() -> jobs.Job:
    """The torus knot over a floor and before a wall."""
    return _job(*shapes.knot_scene(2200, 48))


def hills() -> jobs.Job:
    """A sheet of 10 with hills of 1, and smaller ones on them."""
    vertices, triangles = shapes.grid([-5, -5, 0], [10, 0, 0], [0, 10, 0], 320)
    x, y, _ = vertices.T
    vertices[:, 2] = 0.5 * np.sin(2 * x) * np.cos(2 * y) + 0.12 * np.sin(7 * x + 1) * np.sin(6 * y)
    normals = scenes.smooth_normals(vertices, triangles)
    return _job(shapes.receiver(vertices, triangles, normals), vertices, triangles)


SCENES: dict[str, Callable[[], jobs.Job]] = {"closed": well, "half open": knot, "open": hills}


def _job(receiver: jobs.Receiver, vertices: Any, triangles: Any) -> jobs.Job:
    """Under a smooth sky with a sun."""
    towards = lat_long.directions(256, 512)
    pixels = (1 + 0.6 * np.sin(4 * towards + [0, 1, 2])).astype(np.float32)
    pixels[40:44, 100:104] = 500
    light = jobs.LightSource(pixels=pixels)
    return jobs.Job("bake", jobs.Settings(), light, (receiver,), vertices, triangles)


def met_share(job: jobs.Job) -> float:
    """The share of the rays that meet something, at some of the points."""
    points = distinct_points(job.receivers[0])
    some = np.random.default_rng(0).choice(len(points.origins), SOME, replace=False)
    normals = points.normals[some]
    directions = np.empty((SOME * job.settings.rays, 3), np.float32)
    local = frames(normals, np.zeros(SOME)).matrices()
    RaysInWorld(hemisphere_set(job.settings.rays, 3).directions).directions(local, directions)
    sky = occlusion(job.occluder_vertices, job.occluder_triangles)
    origins = np.repeat(points.origins[some], job.settings.rays, axis=0)
    return float((sky.sky_mask(origins, directions) != CLEAR).mean())


def bouncing(job: jobs.Job, bounces: int, albedos: Albedos) -> jobs.Job:
    """``job`` with light that bounces off triangles of these ``albedos`` in turn."""
    of_triangles = np.array(albedos, np.float32)[
        np.arange(len(job.occluder_triangles)) % len(albedos)
    ]
    of_corners = np.repeat(of_triangles[:, None], 3, axis=1)
    settings = replace(job.settings, bounces=bounces)
    return replace(job, settings=settings, occluder_albedo=of_corners)


def whole_bake(job: jobs.Job) -> tuple[float, dict[str, Any]]:
    """Seconds from the job's arrays to the results' arrays, and the report."""
    start = time.perf_counter()
    with engine.job_folder() as folder:
        for _ in engine.run(job, folder):
            pass
        return time.perf_counter() - start, read_results(folder).report


def row(job: jobs.Job, bounces: int, turns: int) -> list[str]:
    """Points, seconds without bounces and with grey and coloured ones, and these two's ratios."""
    sides = [job, *(bouncing(job, bounces, albedos) for albedos in (GREY, COLOURS))]
    bakes = [[whole_bake(side) for side in sides] for _ in range(turns)]
    points = bakes[0][0][1]["objects"][0]["points"]
    seconds = np.array([[seconds for seconds, _ in turn] for turn in bakes])
    ratios = np.median(seconds[:, 1:] / seconds[:, :1], axis=0)
    medians = (f"{statistics.median(column):.1f}" for column in seconds.T)
    return [f"{points:,}", *medians, *(f"{ratio:.2f}" for ratio in ratios)]


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--turns", type=int, default=5)
    parser.add_argument("--bounces", type=int, default=3)
    parser.add_argument("--scene", nargs="+", choices=list(SCENES), default=list(SCENES))
    parser.add_argument("--settings", nargs="+", choices=list(SETTINGS), default=list(SETTINGS))
    asked = parser.parse_args()
    columns = "scene | rays that meet something | settings | points"
    print(f"| {columns} | without, s | grey, s | coloured, s | grey | coloured |")
    print("|---" * 9 + "|")
    for scene in asked.scene:
        plain = SCENES[scene]()
        met = f"{met_share(plain):.0%}"
        for name in asked.settings:
            job = replace(plain, settings=replace(plain.settings, **SETTINGS[name]))
            cells = row(job, asked.bounces, asked.turns)
            print(f"| {scene} | {met} | {name} | {' | '.join(cells)} |", flush=True)


if __name__ == "__main__":
    main()
