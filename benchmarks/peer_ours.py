"""The engine itself, whole and in its own process, as an artist's bake runs it."""

import time
from dataclasses import dataclass
from typing import Any

import numpy as np
from prt_baker.addon import engine
from prt_baker.addon.prt import job as jobs
from prt_baker.addon.prt.steps import value_of
from scenes import Scene

TRACING = (
    "horizon",
    "effort",
    "transfer",
)  # the report's phases: what may be skipped, and the rays


@dataclass(frozen=True)
class Baked:
    """A bake: ``seconds`` of the whole, from arrays to arrays, of which ``tracing``; ``transfer``
    (P, n²) at the points of every receiver in turn, and the engine's ``report``."""

    seconds: float
    tracing: float
    transfer: np.ndarray
    report: dict[str, Any]


def settings(**chosen: Any) -> jobs.Settings:
    """Transfer at the points and nothing else: what the competitors compute."""
    return jobs.Settings(fit=False, residual=False, verify_points=0, **chosen)


def bake(scene: Scene, chosen: jobs.Settings) -> Baked:
    """One bake of ``scene``: process start, files, points, Embree's structure, rays, error
    estimate."""
    job = scene.job(chosen)
    start = time.perf_counter()
    with engine.job_folder() as folder:
        results = value_of(engine.run(job, folder))
    seconds = time.perf_counter() - start
    transfer = np.concatenate([whole_order(r.transfer[:, 0]) for r in results.receivers])
    tracing = sum(results.report["seconds"].get(phase, 0.0) for phase in TRACING)
    return Baked(seconds, tracing, transfer, results.report)


def whole_order(transfer: np.ndarray) -> np.ndarray:
    """``transfer`` (P, m²) with zeros (P, 9) for bands that were not worth storing."""
    return np.pad(transfer, ((0, 0), (0, 9 - transfer.shape[1])))
