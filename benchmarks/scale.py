"""A scene of millions of triangles and points: memory, seconds by phase, and time a point.

A displaced sheet under a thousand rocks, which together have the triangles asked for.  The sheet is
baked at several sizes under the same rocks; what a point takes must not grow with their number.
And a thousand boxes, as one object, as an object each, and these once more from the cache.
The engine runs in its own process, as in a bake.
"""

import argparse
import resource
import sys
import tempfile
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
from prt_baker.addon import engine
from prt_baker.addon.prt import job as jobs
from prt_baker.addon.prt.results import Results
from prt_baker.addon.prt.steps import value_of

sys.path.insert(0, str(Path(__file__).parents[1] / "tests" / "engine"))
import shapes

ROCKS = 1000
SIZE = 100.0  # metres along a side
# phases whose work grows with the points
OF_POINTS = ("prepare", "horizon", "transfer", "values", "estimate")
Mesh = tuple[np.ndarray, np.ndarray]


def heights(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Hills and ripples."""
    return 3 * np.sin(0.13 * x) * np.cos(0.17 * y) + 0.2 * np.sin(2.1 * x + 1.3 * y)


def sheet(points: int) -> jobs.Receiver:
    """The displaced square, with about as many vertices, smooth."""
    count = max(1, round(points**0.5) - 1)
    vertices, triangles = shapes.grid([0, 0, 0], [SIZE, 0, 0], [0, SIZE, 0], count)
    x, y = vertices[:, 0], vertices[:, 1]
    step = 1e-3
    slope_x = (heights(x + step, y) - heights(x - step, y)) / (2 * step)
    slope_y = (heights(x, y + step) - heights(x, y - step)) / (2 * step)
    vertices[:, 2] = heights(x, y)
    normals = np.stack([-slope_x, -slope_y, np.ones_like(x)], axis=1)
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    return shapes.receiver(vertices, np.ascontiguousarray(triangles), normals, "sheet")


def rocks(triangles: int) -> list[Mesh]:
    """Bumpy balls that lie on the sheet, all together of about as many triangles."""
    rows = max(4, round((triangles / ROCKS / 4) ** 0.5))
    ball, faces, _ = shapes.sphere(rows, 2 * rows)
    ball *= 1 + 0.1 * np.sin(7 * ball[:, :1]) * np.cos(5 * ball[:, 1:2] + 3 * ball[:, 2:])
    random = np.random.default_rng(0)
    places = random.random((ROCKS, 2)) * SIZE
    sizes = random.uniform(0.3, 1.5, ROCKS)
    heights_there = heights(*places.T)
    return [
        (ball * size + [*place, height], faces)
        for place, size, height in zip(places, sizes, heights_there, strict=True)
    ]


def scene(points: int, triangles: int, settings: jobs.Settings) -> jobs.Job:
    """The sheet with ``points`` under rocks; all triangles together are about ``triangles``."""
    receiver = sheet(points)
    ground = (receiver.vertices, receiver.triangles)
    parts = [ground, *rocks(max(0, triangles - len(receiver.triangles)))]
    return job_of((receiver,), parts, settings)


def boxes(count: int, apart: bool, settings: jobs.Settings) -> jobs.Job:
    """So many boxes side by side, of 150 points each: objects of their own where ``apart``."""
    random, side = np.random.default_rng(0), int(np.ceil(count**0.5))
    vertices, faces = shapes.box(1.0, 4, inward=False)
    parts = [
        (vertices * random.uniform(0.5, 1.2, 3) + [1.5 * (i % side), 1.5 * (i // side), 0], faces)
        for i in range(count)
    ]
    whole = parts if apart else [shapes.join(*parts)]
    receivers = [shapes.receiver(*part, name=f"box {i}") for i, part in enumerate(whole)]
    return job_of(tuple(receivers), parts, settings)


def job_of(
    receivers: tuple[jobs.Receiver, ...], parts: list[Mesh], settings: jobs.Settings
) -> jobs.Job:
    """The bake of ``receivers`` among occluders, each one of ``parts``."""
    return jobs.Job(
        settings=settings,
        light=jobs.LightSource(),
        receivers=receivers,
        occluder_vertices=np.concatenate([vertices for vertices, _ in parts]),
        occluder_triangles=joined([faces for _, faces in parts], [len(v) for v, _ in parts]),
        occluder_starts=np.cumsum([0, *(len(faces) for _, faces in parts)]),
    )


def joined(faces: list[np.ndarray], sizes: list[int]) -> np.ndarray:
    """Triangles of meshes whose vertices follow one another."""
    offsets = np.cumsum([0, *sizes[:-1]])
    return np.concatenate(
        [f + np.int32(o) for f, o in zip(faces, offsets, strict=True)], dtype="i4"
    )


def bake(job: jobs.Job) -> tuple[Results, float]:
    """The results, and seconds from arrays to arrays."""
    start = time.perf_counter()
    with engine.job_folder() as folder:
        return value_of(engine.run(job, folder)), time.perf_counter() - start


def many(count: int, settings: jobs.Settings) -> str:
    """What boxes take as one object, as an object each, and these again."""
    with tempfile.TemporaryDirectory() as folder:
        kept = replace(settings, cache=folder)
        together = bake(boxes(count, False, settings))[1]
        job = boxes(count, True, kept)
        (results, apart), (_, again) = bake(job), bake(job)
    points = sum(entry["points"] for entry in results.report["objects"])
    return (
        f"{count:,} boxes, {points:,} points: {together:.1f} s as one object, {apart:.1f} s as an "
        f"object each, {apart / count * 1e3:.1f} ms an object; {again:.1f} s once more, unchanged"
    )


def main() -> None:
    """Print a line for each size, and one for the boxes."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--points", type=int, nargs="+", default=[10_000, 100_000, 1_000_000])
    parser.add_argument("--triangles", type=int, default=10_000_000)
    parser.add_argument("--rays", type=int, default=256)
    parser.add_argument("--threads", type=int, default=2)
    parser.add_argument("--no-fit", action="store_true", help="values at the vertices alone")
    parser.add_argument("--no-residual", action="store_true")
    parser.add_argument("--boxes", type=int, default=1000)
    asked = parser.parse_args()
    settings = jobs.Settings(
        rays=asked.rays,
        threads=asked.threads,
        fit=not asked.no_fit,
        residual=not asked.no_residual,
    )
    for points in asked.points:
        job = scene(points, asked.triangles, settings)
        results, wall = bake(job)
        report = results.report
        (entry,) = report["objects"]
        own = sum(report["seconds"].get(name, 0.0) for name in OF_POINTS)
        phases = ", ".join(f"{name} {s:.2f}" for name, s in report["seconds"].items())
        parent = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20
        print(
            f"{entry['points']:,} points, {len(job.occluder_triangles):,} triangles, "
            f"{entry['rays'] / 1e6:.1f} M rays: {wall:.1f} s ({phases}), "
            f"{own / entry['points'] * 1e6:.1f} µs a point, peak "
            f"{report['peak_memory_bytes'] / 2**30:.2f} GiB, this process {parent:.2f} GiB",
            flush=True,
        )
        del job, results
    print(many(asked.boxes, settings))


if __name__ == "__main__":
    main()
