"""A scan of 109,000 faces into 2048 x 2048 texels: seconds by phase, memory, signs of life.

The engine runs in its own process, as in a bake, and unwraps in children of that.  Memory is what
all of these hold together, pages that several share counted once, looked at ten times a second.
The longest pause is the longest time between two lines of progress.  The light is one of Blender's
HDRIs, so that texels take residuals too.
"""

import argparse
import itertools
import os
import threading
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import scenes
from prt_baker.addon import engine
from prt_baker.addon.prt import job as jobs
from prt_baker.addon.prt.results import Results

EVERY = 0.1  # seconds


class Memory(threading.Thread):
    """Looks at the ``peak`` of what this process's descendants hold, in bytes, until stopped."""

    def __init__(self) -> None:
        super().__init__(daemon=True)
        self.peak, self._stopped = 0, threading.Event()

    def run(self) -> None:
        """Look again and again."""
        while not self._stopped.wait(EVERY):
            self.peak = max(self.peak, sum(map(held, descendants(os.getpid()))))

    def stop(self) -> None:
        """Look no more."""
        self._stopped.set()
        self.join()


def descendants(pid: int) -> list[int]:
    """The processes that ``pid`` has started, and those that they have."""
    found = []
    for task in Path(f"/proc/{pid}/task").glob("*/children"):
        for child in read(task).split():
            found += [int(child), *descendants(int(child))]
    return found


def held(pid: int) -> int:
    """The memory of ``pid`` in bytes, its share of what it shares."""
    lines = read(Path(f"/proc/{pid}/smaps_rollup")).splitlines()
    return sum(1024 * int(line.split()[1]) for line in lines if line.startswith("Pss:"))


def read(path: Path) -> str:
    """What ``path`` says; "" where its process has gone."""
    try:
        return path.read_text()
    except OSError:
        return ""


def bake(job: jobs.Job) -> tuple[Results, float, dict[str, float]]:
    """The results, seconds from arrays to arrays, and the longest pause of each phase."""
    start = last = time.perf_counter()
    pauses: dict[str, float] = {}
    with engine.job_folder() as folder:
        steps, seen = engine.run(job, folder), jobs.Progress("start", 0.0)
        while True:
            try:
                step = next(steps)
            except StopIteration as stop:
                step = None
                results = stop.value
            now = time.perf_counter()
            if step != seen:
                pauses[seen.phase] = max(pauses.get(seen.phase, 0.0), now - last)
                last, seen = now, step
            if step is None:
                return results, now - start, pauses


def main() -> None:
    """Print what it takes."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--size", type=int, default=2048)
    parser.add_argument("--tolerance", type=float, default=0.01)
    parser.add_argument("--rays", type=int, default=256)
    parser.add_argument("--threads", type=int, default=2)
    parser.add_argument("--light", type=Path, help="an HDRI; default: a plain sky")
    asked = parser.parse_args()
    its = {name: getattr(asked, name) for name in ("tolerance", "rays", "threads")}
    settings = jobs.Settings(resolution=asked.size, **its)
    job = scenes.snowden().job(settings)
    image = str(asked.light) if asked.light else None
    receivers = tuple(replace(receiver, carrier="texture") for receiver in job.receivers)
    job = replace(job, light=jobs.LightSource(image=image), receivers=receivers)
    memory = Memory()
    memory.start()
    results, wall, pauses = bake(job)
    memory.stop()
    print(described(results, wall, pauses, memory.peak))


def described(results: Results, wall: float, pauses: dict[str, float], peak: int) -> str:
    """Some lines about a bake."""
    (entry,), (atlas,) = results.report["objects"], results.atlases
    phases = ", ".join(f"{name} {s:.1f}" for name, s in results.report["seconds"].items())
    longest = sorted(pauses.items(), key=lambda pause: -pause[1])
    said = ", ".join(f"{name} {seconds:.2f}" for name, seconds in itertools.islice(longest, 5))
    return (
        f"{atlas.size}², {len(atlas.names)} numbers a texel, {entry['points']:,} texels, "
        f"{np.round(entry['rays'] / 1e6):.0f} M rays: {wall:.0f} s ({phases})\n"
        f"peak of all processes {peak / 2**30:.2f} GiB\n"
        f"longest pauses, s: {said}"
    )


if __name__ == "__main__":
    main()
