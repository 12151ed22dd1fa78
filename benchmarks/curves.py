"""Error against run time of the engine and its competitors, taking turns: measured and kept.

Prints what it measures and writes it to .cache/bench/curves.json, from which curves_page.py makes
pictures and tables.
"""

import argparse
import json
import platform
import time
from collections import defaultdict
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import peer_ours
from peers import BakedMesh, Traced, Worker, World
from prt_baker.addon.prt.parallel import available_cores
from reference import Reference, reference
from scenes import BUILDERS, CACHE, SMALL, Scene

Array = np.ndarray

TOLERANCES = (0.05, 0.02, 0.01, 0.005)
ENOUGH = 0.004  # no more rays once the error is below


@dataclass(frozen=True)
class Effort:
    """How long a measurement may take: ``points`` of the reference, ``turns`` of every competitor,
    ``seconds`` that one run may take, and in the scenes that the targets are about."""

    points: int
    turns: int
    seconds: float
    target_seconds: float


SHORT = Effort(points=1500, turns=2, seconds=4.0, target_seconds=16.0)
FULL = Effort(points=2000, turns=2, seconds=8.0, target_seconds=40.0)
TARGETS = ("knot", "cortex", "field")


@dataclass(frozen=True)
class Method:
    """A competitor's way to bake: its peer's ``module`` and what that calls it."""

    name: str
    module: str
    kind: str = ""
    first_rays: int = 16


METHODS = (
    Method("textbook", "peer_textbook"),
    Method("mitsuba_independent", "peer_mitsuba", "independent"),
    Method("mitsuba_low_discrepancy", "peer_mitsuba", "low_discrepancy"),
    Method("mitsuba_our_directions", "peer_mitsuba", "ours"),
    Method("cycles", "peer_cycles", first_rays=4),
)
OURS = "ours"


@dataclass
class Run:
    """All turns of one competitor at one count of rays: seconds of tracing, seconds of the whole,
    and the values at the reference's points."""

    rays: int
    tracing: list[float] = field(default_factory=list)
    whole: list[float] = field(default_factory=list)
    values: list[Array] = field(default_factory=list)

    def summary(self, truth: Reference) -> dict[str, Any]:
        """Medians, and errors: all of it, the noise alone (by how far two seeds differ), and what
        two seeds have in common, which more rays would not mend."""
        first, last = self.values[0], self.values[-1]
        common = np.sum(truth.weight[:, None] * (first - truth.transfer) * (last - truth.transfer))
        size = np.sum(truth.weight[:, None] * truth.transfer**2)
        errors = [truth.error_of(values) for values in self.values]
        return {
            "rays": self.rays,
            "tracing": float(np.median(self.tracing)),
            "whole": float(np.median(self.whole)),
            "error": float(np.mean(np.square(errors)) ** 0.5),
            "noise": truth.rms(first - last) / 2**0.5,
            "bias": float(max(0.0, common / size) ** 0.5),
        }


class Ours:
    """The engine, as a competitor."""

    def __init__(self, scene: Scene) -> None:
        self._scene = scene

    def __call__(self, rays: int, seed: int) -> tuple[float, float, Array]:
        """Seconds of tracing and of the whole, and the transfer (P, n²)."""
        baked = peer_ours.bake(self._scene, peer_ours.settings(rays=rays, seed=seed))
        return baked.tracing, baked.seconds, baked.transfer


class Peer:
    """A competitor in a worker process; what preparing took counts to the whole."""

    def __init__(self, worker: Worker, kind: str, preparation: float) -> None:
        self._worker, self._kind, self._preparation = worker, kind, preparation

    def __call__(self, rays: int, seed: int) -> tuple[float, float, Array]:
        """Seconds of tracing and of the whole, and the transfer (P, n²)."""
        traced: Traced = self._worker.ask("trace", self._kind, rays, seed)
        return traced.seconds, traced.seconds + self._preparation, traced.transfer


Competitor = Callable[[int, int], tuple[float, float, Array]]


def main() -> None:
    """Every scene; what was measured before is kept where only some are asked for."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--full", action="store_true", help="larger scenes, more rays")
    parser.add_argument("--scene", action="append", choices=list(BUILDERS))
    parser.add_argument("--out", type=Path, default=CACHE / "curves.json")
    asked = parser.parse_args()
    effort, builders = (FULL, BUILDERS) if asked.full else (SHORT, SMALL)
    measured: dict[str, Any] = {"form": "full" if asked.full else "short", **about_machine()}
    measured |= {"scenes": {}, "missing": {}}
    for name in asked.scene or builders:
        start = time.perf_counter()
        try:
            scene = builders[name]()
        except ModuleNotFoundError as error:
            measured["missing"][name] = str(error)
            continue
        measured["scenes"][name] = measure(scene, effort)
        print(f"{name}: {time.perf_counter() - start:.0f} s", flush=True)
        asked.out.parent.mkdir(parents=True, exist_ok=True)
        asked.out.write_text(json.dumps(measured, indent=1), encoding="utf-8")


def about_machine() -> dict[str, Any]:
    """Processor, cores, Python."""
    model = platform.processor() or platform.machine()
    info = Path("/proc/cpuinfo")
    if info.exists():
        names = [line for line in info.read_text().splitlines() if line.startswith("model name")]
        model = names[0].partition(":")[2].strip() if names else model
    return {
        "processor": model,
        "cores": available_cores(),
        "system": platform.system(),
        "python": platform.python_version(),
    }


def measure(scene: Scene, effort: Effort) -> dict[str, Any]:
    """All that is measured of one scene."""
    truth = reference(scene, effort.points, CACHE)
    workers, missing, versions = start_workers(scene)
    seconds = effort.target_seconds if scene.name in TARGETS else effort.seconds
    try:
        competitors: dict[str, Competitor] = {OURS: Ours(scene)}
        preparation = {m: w.ask("prepare", world_of(scene, m)) for m, w in workers.items()}
        for method in METHODS:
            if method.module in workers:
                worker = workers[method.module]
                peer = Peer(worker, method.kind, preparation[method.module])
                competitors[method.name] = peer
        runs = take_turns(competitors, truth, seconds, effort.turns)
        compiling = mitsuba_compiling(workers)
    finally:
        for worker in workers.values():
            worker.close()
    return {
        "title": scene.title,
        "points": len(scene.origins),
        "triangles": len(scene.centred.occluder_triangles),
        "reference": {"points": len(truth.chosen), "error": truth.error},
        "missing": missing,
        "versions": versions,
        "compile_seconds": compiling,
        "methods": {
            name: [run.summary(truth) for run in its.values()] for name, its in runs.items()
        },
        "tolerance": tolerances(scene, truth),
    }


def start_workers(scene: Scene) -> tuple[dict[str, Worker], dict[str, str], dict[str, str]]:
    """The peers that are installed, by module; why others are not; versions of all."""
    workers, missing, versions = {}, {}, {}
    for module in dict.fromkeys(method.module for method in METHODS):
        if module == "peer_cycles" and not scene.is_fair_to_cycles:
            continue
        worker = Worker(module)
        try:
            versions.update(worker.ask("versions"))
        except ImportError as error:
            missing[module] = str(error)
            worker.close()
        else:
            workers[module] = worker
    return workers, missing, versions


def mitsuba_compiling(workers: dict[str, Worker]) -> float | None:
    """Seconds that Mitsuba's kernels took to compile, which no measurement holds."""
    worker = workers.get("peer_mitsuba")
    return worker.ask("compile_seconds") if worker else None


def world_of(scene: Scene, module: str) -> World:
    """What the peer in ``module`` is given."""
    job = scene.centred
    vertices, triangles = np.array(job.occluder_vertices), np.array(job.occluder_triangles)
    mesh = None
    if module == "peer_cycles":
        (receiver,), (points,) = job.receivers, scene.points
        count = len(receiver.vertices)
        mesh = BakedMesh(
            *(np.array(a) for a in (receiver.vertices, receiver.normals, receiver.triangles)),
            vertex_points=points.element_points,
            other_vertices=vertices[count:],
            other_triangles=triangles[len(receiver.triangles) :] - count,
        )
    return World(scene.origins, scene.normals, vertices, triangles, mesh)


def take_turns(
    competitors: dict[str, Competitor], truth: Reference, longest: float, turns: int
) -> dict[str, dict[int, Run]]:
    """Four times the rays at every step, all competitors one after the other, ``turns`` times."""
    first = {method.name: method.first_rays for method in METHODS}
    runs: dict[str, dict[int, Run]] = defaultdict(dict)
    going, step = set(competitors), 0
    while going:
        for turn in range(turns):
            for name in [name for name in competitors if name in going]:
                rays = first.get(name, 16) * 4**step
                run = runs[name].setdefault(rays, Run(rays))
                tracing, whole, transfer = competitors[name](rays, turn + 1)
                run.tracing.append(tracing)
                run.whole.append(whole)
                run.values.append(transfer[truth.chosen].astype(np.float64))
        print_step(
            {name: list(runs[name].values())[-1] for name in competitors if name in going}, truth
        )
        going = {name for name in going if goes_on(list(runs[name].values()), truth, longest)}
        step += 1
    return dict(runs)


def goes_on(runs: list[Run], truth: Reference, longest: float) -> bool:
    """Whether four times the rays would be of use and not take too long; two steps are made."""
    last = runs[-1].summary(truth)
    if last["noise"] < ENOUGH and len(runs) > 1:
        return False
    return len(runs) < 2 or 4 * last["tracing"] <= longest


def print_step(step: dict[str, Run], truth: Reference) -> None:
    """A line for each competitor that took part."""
    for name, run in step.items():
        s = run.summary(truth)
        figures = f"{s['rays']:6d} rays {s['tracing']:8.3f} s of {s['whole']:8.3f} s"
        print(f"  {name:24s} {figures} {s['error']:8.3%} (bias {s['bias']:.3%})", flush=True)


def tolerances(scene: Scene, truth: Reference) -> list[dict[str, Any]]:
    """Of each receiver at each tolerance: rays a point and error; nothing where the engine does not
    say how many rays it took."""
    rows = []
    for tolerance in TOLERANCES:
        baked = peer_ours.bake(scene, peer_ours.settings(tolerance=tolerance))
        for number, entry in enumerate(baked.report["objects"]):
            its = truth.of_receiver(number)
            if "rays_per_point" in entry and len(its.chosen):
                rows.append(
                    {
                        "object": entry["name"],
                        "tolerance": tolerance,
                        "rays": entry["rays_per_point"],
                        "estimated": entry["estimated_error"],
                        "error": its.error_of(baked.transfer[its.chosen]),
                    }
                )
    return rows


if __name__ == "__main__":
    main()
