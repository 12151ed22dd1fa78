"""What a competitor is to the benchmark: a module in a process of its own, asked in turns."""

import importlib
import multiprocessing
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from typing import Any

import numpy as np
from prt_baker.addon.prt.parallel import available_cores

Array = np.ndarray


@dataclass(frozen=True)
class World:
    """What a competitor is given, all centred: ray ``origins`` and unit ``normals`` (P, 3) float32
    of the points in the engine's order, the occluders, the receiver's own mesh with the place of
    each of its vertices among the points (None where Cycles does not take part), and how many
    ``threads`` it may use."""

    origins: Array
    normals: Array
    vertices: Array
    triangles: Array
    baked: "BakedMesh | None"
    threads: int = available_cores()


@dataclass(frozen=True)
class BakedMesh:
    """A receiver for Cycles: ``vertices`` (V, 3), their ``normals``, ``triangles``, the point of
    each vertex ``vertex_points`` (V,), and the mesh of everything else."""

    vertices: Array
    normals: Array
    triangles: Array
    vertex_points: Array
    other_vertices: Array
    other_triangles: Array


@dataclass(frozen=True)
class Traced:
    """A measurement: the ``seconds`` of tracing and the ``transfer`` (P, n²)."""

    seconds: float
    transfer: Array


class Worker:
    """A peer's module in its own process.

    The module has ``versions() -> dict`` (raising ImportError where the peer is not installed),
    ``prepare(world) -> float`` seconds, and ``trace(method, rays, seed) -> Traced``.
    """

    def __init__(self, module: str) -> None:
        self._module = module
        context = multiprocessing.get_context("spawn")
        self._process = ProcessPoolExecutor(1, mp_context=context)

    def ask(self, function: str, *arguments: Any) -> Any:
        """The value of the module's ``function``, run in the process."""
        return self._process.submit(_call, self._module, function, arguments).result()

    def close(self) -> None:
        """End the process."""
        self._process.shutdown()


def _call(module: str, function: str, arguments: tuple[Any, ...]) -> Any:
    return getattr(importlib.import_module(module), function)(*arguments)
