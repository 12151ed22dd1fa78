"""Unwrapping meshes of several sizes into one atlas: seconds, processor seconds, memory.

A torus knot, smooth, of squares; with --slivers one of triangles that are the longer, the more
there are (35 times as long as high at 500,000), for which xatlas takes longest; with --flat a ball
of which every side shades by itself.  Each is unwrapped twice, and the bytes compared.  The largest
pause is the longest time without a sign of life.
"""

import argparse
import resource
import sys
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from prt_baker.addon.prt.atlas import uv_map
from prt_baker.addon.prt.atlas.plane import plane_areas
from prt_baker.addon.prt.atlas.unwrap import Unwrapped, unwrap
from prt_baker.addon.prt.job import Receiver

sys.path.insert(0, str(Path(__file__).parents[1] / "tests" / "engine"))
import shapes

COLUMNS = 25  # vertices around the tube of the knot of slivers
SQUARE = 0.09  # of the knot's triangles: the square of the columns that make squares


@dataclass(frozen=True)
class Run:
    """An atlas, the ``wall`` seconds that it took, the processor seconds of this process and of its
    children, and the longest ``pause`` between two steps."""

    atlas: Unwrapped
    wall: float
    own: float
    children: float
    pause: float


def knot(triangles: int) -> Receiver:
    """A smooth torus knot of about as many triangles, halves of squares."""
    columns = round((SQUARE * triangles / 2) ** 0.5)
    return shapes.receiver(*shapes.torus_knot(triangles // (2 * columns), columns), name="knot")


def slivers(triangles: int) -> Receiver:
    """A smooth torus knot of about as many triangles, long ones."""
    return shapes.receiver(*shapes.torus_knot(triangles // (2 * COLUMNS), COLUMNS), name="slivers")


def flat_ball(triangles: int) -> Receiver:
    """A ball of about as many triangles, flat-shaded: each side of it is a chart."""
    rows = round((triangles / 4) ** 0.5)
    return shapes.receiver(*shapes.sphere(rows, 2 * rows)[:2], name="flat ball")


def of_children() -> float:
    """Processor seconds of all children that have ended."""
    usage = resource.getrusage(resource.RUSAGE_CHILDREN)
    return usage.ru_utime + usage.ru_stime


def timed(receiver: Receiver, size: int, padding: int, threads: int) -> Run:
    """Unwrap ``receiver``."""
    before, own, start = of_children(), time.process_time(), time.perf_counter()
    last, pause = start, 0.0
    steps = unwrap([receiver], size=size, density=0.0, padding=padding, threads=threads)
    while True:
        try:
            next(steps)
        except StopIteration as stop:
            wall = time.perf_counter() - start
            return Run(stop.value, wall, time.process_time() - own, of_children() - before, pause)
        now = time.perf_counter()
        last, pause = now, max(pause, now - last)


def described(receiver: Receiver, run: Run, again: Run) -> str:
    """A line about two runs."""
    (uvs,) = run.atlas.uvs
    count = int(uv_map.charts(receiver, uvs).max()) + 1
    corners = uvs[receiver.triangle_corners].astype(np.float64)
    share = np.abs(plane_areas(corners)).sum()
    same = "the same bytes" if uvs.tobytes() == again.atlas.uvs[0].tobytes() else "OTHER BYTES"
    peaks = [
        resource.getrusage(who).ru_maxrss / 2**20
        for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)
    ]
    return (
        f"{receiver.name}, {len(receiver.triangles):,} triangles: {run.atlas.size}², "
        f"{count:,} charts, {100 * share:.0f} % used, {min(run.wall, again.wall):.1f} s "
        f"(processor: {run.own:.1f} here, {run.children:.1f} in children), "
        f"pause {max(run.pause, again.pause):.2f} s, {same} again, "
        f"peak {peaks[0]:.2f} GiB here, {peaks[1]:.2f} in a child"
    )


def main() -> None:
    """Print a line for each size."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--triangles", type=int, nargs="+", default=[20_000, 100_000, 500_000])
    parser.add_argument("--size", type=int, default=2048)
    parser.add_argument("--padding", type=int, default=4)
    parser.add_argument("--threads", type=int, default=2)
    shape = parser.add_mutually_exclusive_group()
    for make, says in ((flat_ball, "a ball of flat triangles"), (slivers, "long triangles")):
        option = f"--{make.__name__.partition('_')[0]}"
        shape.add_argument(option, action="store_const", const=make, dest="make", help=says)
    asked = parser.parse_args()
    for triangles in asked.triangles:
        receiver = (asked.make or knot)(triangles)
        runs = [timed(receiver, asked.size, asked.padding, asked.threads) for _ in range(2)]
        print(described(receiver, *runs), flush=True)


if __name__ == "__main__":
    main()
