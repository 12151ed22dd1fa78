"""The rate of whole bakes beside a bare embreex loop over the same rays.

Both use the same threads, robust flag and order of rays, and take turns in one run.  The bake is
the engine's whole run in its own process: start, job and results on disk, points, acceleration
structure, rays, error estimate.  Its rate counts the rays that it cast and none that it could skip;
values are fitted to nothing and no residual is found, so that both cast the same rays.
"""

import argparse
import statistics
import sys
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
from prt_baker.addon import engine
from prt_baker.addon.prt import job as jobs
from prt_baker.addon.prt.parallel import available_cores
from prt_baker.addon.prt.results import read_results
from prt_baker.addon.prt.surface.points import distinct_points
from prt_baker.addon.prt.tracing.hemisphere import RaysInWorld, frames, hemisphere_set
from prt_baker.addon.prt.tracing.rays import Occlusion, occlusion
from prt_baker.addon.prt.tracing.transfer import BATCH_RAYS

sys.path.insert(0, str(Path(__file__).parents[1] / "tests" / "engine"))
import shapes

Rays = tuple[np.ndarray, np.ndarray]


def knot_job(rows: int, columns: int, rays: int) -> jobs.Job:
    """The torus knot over floor and wall, with ``rows * columns`` points."""
    receiver, vertices, triangles = shapes.knot_scene(rows, columns)
    settings = jobs.Settings(rays=rays, fit=False, residual=False)
    return jobs.Job("bake", settings, jobs.LightSource(), (receiver,), vertices, triangles)


def same_rays(job: jobs.Job) -> Rays:
    """Every ray of the bake, origins and directions, in its order."""
    points = distinct_points(job.receivers[0])
    count, rays = len(points.origins), job.settings.rays
    random = np.random.default_rng([job.settings.seed, rays])
    local = frames(points.normals, random.random(count) * 2 * np.pi)
    directions = np.empty((count * rays, 3), np.float32)
    in_world = RaysInWorld(hemisphere_set(rays, job.settings.order).directions)
    in_world.directions(local.matrices(), directions)
    return np.repeat(points.origins, rays, axis=0), directions


def bare_loop(sky: Occlusion, rays: Rays, threads: int) -> float:
    """Seconds that embreex alone takes for ``rays``."""
    origins, directions = rays
    parts = [slice(i, i + BATCH_RAYS) for i in range(0, len(origins), BATCH_RAYS)]
    start = time.perf_counter()
    with ThreadPoolExecutor(threads) as pool:
        list(pool.map(lambda part: sky.sky_mask(origins[part], directions[part]), parts))
    return time.perf_counter() - start


def whole_bake(job: jobs.Job) -> tuple[float, int]:
    """Seconds from the job's arrays to the results' arrays, and the rays cast."""
    start = time.perf_counter()
    with engine.job_folder() as folder:
        for _ in engine.run(job, folder):
            pass
        seconds = time.perf_counter() - start
        (entry,) = read_results(folder).report["objects"]
    return seconds, entry["rays"]


def main() -> None:
    """Print both rates and their ratio, medians of several turns."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--turns", type=int, default=5)
    parser.add_argument("--rays", type=int, default=256)
    asked = parser.parse_args()
    job = knot_job(2200, 48, asked.rays)
    rays = same_rays(job)
    sky = occlusion(job.occluder_vertices, job.occluder_triangles, len(rays[0]))
    threads = available_cores()
    count = len(rays[0]) / 1e6
    turns = []
    for _ in range(asked.turns):
        bare, (whole, cast) = bare_loop(sky, rays, threads), whole_bake(job)
        turns.append((count / bare, cast / 1e6 / whole))
    bare, whole = (statistics.median(column) for column in zip(*turns, strict=True))
    ratio = statistics.median(w / b for b, w in turns)
    print(f"{count:.1f} M rays, {len(job.occluder_triangles):,} triangles, {threads} threads")
    print(f"bare embreex loop {bare:.2f} Mrays/s, whole bake {whole:.2f} Mrays/s")
    print(f"ratio {ratio:.2f} (median of {asked.turns} turns)")


if __name__ == "__main__":
    main()
