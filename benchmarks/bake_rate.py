"""The rate of whole bakes beside a bare embreex loop over the same rays.

A bake in this process, on one thread, writes down where each ray starts and goes that the engine
asks embreex for, those of its pilots and of its estimate too.  The bare loop hands just these to
embreex, in that order and in batches as large as the engine's, to the same structure and on as many
threads as the bake has.  The bake is the engine's whole run in its own process: start, job and
results on disk, points, acceleration structure, rays, error estimate.  Its work is what it does
once it runs and has the structure, as the bare loop has: from the mesh's arrays to the values'.
Its tracing are the phases that cast the rays: from points to coefficients.
Values are fitted to nothing and no residual is found, whose rays are no part of it.  All take
turns.

Where the engine knows of rays that they reach the sky, there are two bare loops: one over all rays
of the bake, as a bake without that knowledge would cast them, and one over those that are cast.
The open field is as large as memory lets all its rays be written down.
"""

import argparse
import statistics
import tempfile
import time
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path

import numpy as np
import peer_ours
import scenes
from prt_baker.addon.prt import baking
from prt_baker.addon.prt import job as jobs
from prt_baker.addon.prt.cache import Cache
from prt_baker.addon.prt.light.world import World
from prt_baker.addon.prt.meter import Meter
from prt_baker.addon.prt.parallel import available_cores
from prt_baker.addon.prt.steps import value_of
from prt_baker.addon.prt.tracing.rays import Geometry, Mask, Met, Vectors
from prt_baker.addon.prt.tracing.transfer import NOTHING_ABOVE

SCENES = {
    "torus knot": lambda: scenes.knot(2200, 48),
    "cortex": scenes.cortex,
    "open field": lambda: scenes.field(quads=500),
}
RAYS = {"torus knot": [256, 1024, 2048], "cortex": [256, 1024, 4096], "open field": [256, 1024]}
HEADER = """| scene | points | rays a point | rays | bare embreex loop | whole bake | ratio \
| its work, ratio | its tracing, ratio | cast of them | its work, of what is cast alone |
|---|---|---|---|---|---|---|---|---|---|---|"""
BEFORE = ("light", "acceleration structure")  # phases that come before a bake's work
ESTIMATE = "estimate"  # the phase that casts rays after the others
LONG, MOST_TURNS = 5.0, 15  # seconds of the loop after which a few turns tell as much as more


class Recording:
    """A geometry that writes down the rays that it is asked for the sky, in ``batches`` of origins
    and directions."""

    def __init__(self, geometry: Geometry) -> None:
        self.geometry, self.batches = geometry, list[tuple[Vectors, Vectors]]()
        self.lets_slip = geometry.lets_slip

    @property
    def rays(self) -> int:
        """How many."""
        return sum(len(origins) for origins, _ in self.batches)

    def sky_mask(self, origins: Vectors, directions: Vectors) -> Mask:
        """The geometry's own."""
        self.batches.append((origins.copy(), directions.copy()))
        return self.geometry.sky_mask(origins, directions)

    def watertight(self) -> Geometry:
        """The geometry's own, for the few rays that are cast again."""
        return self.geometry.watertight()

    def meets_back(self, origins: Vectors, directions: Vectors) -> np.ndarray:
        """The geometry's own."""
        return self.geometry.meets_back(origins, directions)

    def first_met(self, origins: Vectors, directions: Vectors) -> Met:
        """The geometry's own."""
        return self.geometry.first_met(origins, directions)


def recorded(job: jobs.Job, all_are_cast: bool) -> tuple[Recording, int]:
    """The rays of a bake of ``job``, with the structure that they are cast at, and how many need
    not be cast; these too are among them if ``all_are_cast``."""
    with tempfile.TemporaryDirectory() as folder:
        one_thread = replace(job, settings=replace(job.settings, threads=1))
        jobs.write(one_thread, Path(folder))
        job = jobs.read(Path(folder))
        cache = Cache("")
        scene = baking.Scene(job, World(job, cache), cache, Meter())
        scene.occlusion = Recording(scene.occlusion)
        if all_are_cast:
            scene.surroundings.horizon = lambda *_: None
        bakes = [value_of(baking.bake(scene, index)) for index in range(len(job.receivers))]
        skipped = sum(baked.entry["skipped"].get(NOTHING_ABOVE, 0) for baked in bakes)
        return scene.occlusion, skipped


def bare_loop(rays: Recording, threads: int) -> float:
    """Seconds that embreex alone takes for ``rays``."""
    start = time.perf_counter()
    with ThreadPoolExecutor(threads) as pool:
        list(pool.map(lambda batch: rays.geometry.sky_mask(*batch), rays.batches))
    return time.perf_counter() - start


def whole_bake(scene: scenes.Scene, chosen: jobs.Settings) -> tuple[float, float, float]:
    """Seconds from the job's arrays to the results' arrays, of its work, and of its tracing."""
    baked = peer_ours.bake(scene, chosen)
    phases: dict[str, float] = baked.report["seconds"]
    work = sum(seconds for name, seconds in phases.items() if name not in BEFORE)
    return baked.seconds, work, baked.tracing + phases.get(ESTIMATE, 0.0)


def row(title: str, scene: scenes.Scene, rays: int, turns: int) -> str:
    """One line of the table: medians of ``turns``, and of more where they are short."""
    chosen, threads = peer_ours.settings(rays=rays), available_cores()
    job = scene.job(chosen)
    cast, skips = recorded(job, all_are_cast=False)
    every = recorded(job, all_are_cast=True)[0] if skips else cast
    taken = []
    while len(taken) < turns or (sum(t[0] for t in taken) < LONG and len(taken) < MOST_TURNS):
        bare, bake = bare_loop(every, threads), whole_bake(scene, chosen)
        taken.append((bare, *bake, bare_loop(cast, threads) if skips else bare))
    bare, whole = (
        every.rays / statistics.median(column) for column in [*zip(*taken, strict=True)][:2]
    )

    def ratio(loop: int, bake: int) -> float:
        return statistics.median(its[loop] / its[bake] for its in taken)

    return (
        f"| {title} | {len(scene.origins):,} | {rays:,} | {every.rays / 1e6:.1f} M "
        f"| {bare / 1e6:.2f} Mrays/s | {whole / 1e6:.2f} Mrays/s | {ratio(0, 1):.2f} "
        f"| **{ratio(0, 2):.2f}** | {ratio(0, 3):.2f} | {cast.rays / every.rays:.0%} "
        f"| {ratio(4, 2):.2f} |"
    )


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--turns", type=int, default=3)
    parser.add_argument("--rays", type=int, nargs="*", help="a point; all of them are held at once")
    parser.add_argument("--scene", default="", help="only scenes whose name has this")
    asked = parser.parse_args()
    print(HEADER)
    for title, build in SCENES.items():
        if asked.scene in title:
            scene = build()
            for rays in asked.rays or RAYS[title]:
                print(row(title, scene, rays, asked.turns), flush=True)


if __name__ == "__main__":
    main()
