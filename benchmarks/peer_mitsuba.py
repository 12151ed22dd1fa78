"""Mitsuba 3 on the processor: one fused kernel, rays, basis and sums in registers.

A lane a point, a loop over its rays.  Directions are the renderer's own independent samples, its
own low-discrepancy points (the radical inverse and Sobol's second dimension of its ``ldsampler``,
scrambled for each point), or ours.
"""

import os
import time
from collections.abc import Callable
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np
from peers import Traced, World
from prt_baker.addon.prt import sh

LIBRARIES = "*/libLLVM.so.19*"  # llvm 15 and 16 stop on processors newer than they are
GOLDEN_TURN = round(2**32 * (3 - 5**0.5) / 2)  # the golden angle in 2^-32 turns, which wrap exactly

state: dict[str, Any] = {}


def versions() -> dict[str, str]:
    """Of what it is made of; ImportError where it or LLVM is missing."""
    mitsuba()
    return {name: version(name) for name in ("mitsuba", "drjit")}


def mitsuba() -> Any:
    """The package, set to compile for the processor."""
    found = sorted(Path("/usr/lib").glob(LIBRARIES))
    if found:
        os.environ.setdefault("DRJIT_LIBLLVM_PATH", str(found[0]))
    import drjit
    import mitsuba as mi

    mi.set_variant("llvm_ad_rgb")
    if not drjit.has_backend(drjit.JitBackend.LLVM):
        raise ImportError("Mitsuba finds no LLVM: apt-get install libllvm19")
    return mi


def prepare(world: World) -> float:
    """Build the scene and compile every kernel; seconds of the first."""
    import drjit as dr

    mi = mitsuba()
    dr.set_thread_count(world.threads)
    start = time.perf_counter()
    mesh = mi.Mesh("occluders", len(world.vertices), len(world.triangles))
    parameters = mi.traverse(mesh)
    parameters["vertex_positions"] = np.ascontiguousarray(world.vertices, np.float32).reshape(-1)
    parameters["faces"] = np.ascontiguousarray(world.triangles, np.uint32).reshape(-1)
    parameters.update()
    state["scene"] = mi.load_dict({"type": "scene", "mesh": mesh})
    seconds = time.perf_counter() - start
    state["origins"] = mi.Point3f(np.ascontiguousarray(world.origins.T))
    state["normals"] = mi.Normal3f(np.ascontiguousarray(world.normals.T))
    compile_start = time.perf_counter()
    for method in METHODS:
        trace(method, 1, 0)
    state["compile_seconds"] = time.perf_counter() - compile_start
    return seconds


def compile_seconds() -> float:
    """What compiling took, which no measurement holds."""
    return float(state["compile_seconds"])


def trace(method: str, rays: int, seed: int) -> Traced:
    """Transfer of every point with ``rays`` rays each, by one of METHODS."""
    import drjit as dr

    start = time.perf_counter()
    transfer = METHODS[method](rays, seed)
    dr.eval(transfer)  # all at once: one kernel
    values = np.stack([t.numpy() for t in transfer], axis=1)
    return Traced(time.perf_counter() - start, values)


def independent(rays: int, seed: int) -> list[Any]:
    """Mitsuba's ``independent`` sampler and its warp to the cosine."""
    mi = mitsuba()
    sampler = mi.load_dict({"type": "independent"})
    sampler.seed(seed, len(state["origins"].x))

    def direction(_i: Any, sampler: Any) -> Any:
        return mi.warp.square_to_cosine_hemisphere(sampler.next_2d())

    lit, _ = sums(direction, sampler, rays)
    return lit


def low_discrepancy(rays: int, seed: int) -> list[Any]:
    """The points of Mitsuba's ``ldsampler``, scrambled for each of ours."""
    import drjit as dr

    mi = mitsuba()
    lanes = dr.arange(mi.UInt32, len(state["origins"].x))
    scrambles = mi.sample_tea_32(lanes, dr.opaque(mi.UInt32, seed))
    dr.eval(scrambles)

    def direction(i: Any, _sampler: None) -> Any:
        point = mi.Point2f(mi.radical_inverse_2(i, scrambles[0]), mi.sobol_2(i, scrambles[1]))
        return mi.warp.square_to_cosine_hemisphere(point)

    lit, _ = sums(direction, None, rays)
    return lit


def ours(rays: int, seed: int) -> list[Any]:
    """Our directions, made in the kernel: the cosine's Fibonacci set, turned by a random angle for
    each point, and the correction that makes an open point exact."""
    import drjit as dr

    mi = mitsuba()
    lanes = dr.arange(mi.UInt32, len(state["origins"].x))
    azimuth, _ = mi.sample_tea_32(lanes, dr.opaque(mi.UInt32, seed))
    count = dr.opaque(mi.Float, rays)
    dr.eval(azimuth)

    def direction(i: Any, _sampler: None) -> Any:
        turns = mi.Float(i * mi.UInt32(GOLDEN_TURN) + azimuth) * 2**-32
        squared = (mi.Float(i) + 0.5) / count
        radius = dr.sqrt(squared)
        sine, cosine = dr.sincos(turns * (2 * np.pi))
        return mi.Vector3f(radius * cosine, radius * sine, dr.sqrt(1 - squared))

    lit, unshadowed = sums(direction, None, rays)
    visible = lit[0] / unshadowed[0]
    factors = (sh.clamped_cosine(3) / np.pi)[sh.bands(3)].tolist()
    is_open = [f * y for f, y in zip(factors, basis(state["normals"]), strict=True)]
    return [t + visible * (o - u) for t, o, u in zip(lit, is_open, unshadowed, strict=True)]


METHODS: dict[str, Callable[[int, int], list[Any]]] = {
    "independent": independent,
    "low_discrepancy": low_discrepancy,
    "ours": ours,
}


def sums(
    direction: Callable[[Any, Any], Any], sampler: Any, rays: int
) -> tuple[list[Any], list[Any]]:
    """Nine means a lane over the rays that reach the sky, and over all of them.

    ``direction(i, sampler)`` gives ray i's direction about +z.  What of the second nobody reads is
    not computed.
    """
    import drjit as dr

    mi = mitsuba()
    scene, origins = state["scene"], state["origins"]
    frame = mi.Frame3f(state["normals"])
    lanes = len(origins.x)
    limit = dr.opaque(mi.UInt32, rays)  # no new kernel for another count

    def one_ray(i: Any, sampler: Any, lit: list[Any], every: list[Any]) -> tuple[Any, ...]:
        towards = frame.to_world(direction(i, sampler))
        is_blocked = scene.ray_test(mi.Ray3f(origins, towards))
        values = basis(towards)
        lit = [s + dr.select(is_blocked, 0, y) for s, y in zip(lit, values, strict=True)]
        every = [s + y for s, y in zip(every, values, strict=True)]
        return i + 1, sampler, lit, every

    start = [[dr.zeros(mi.Float, lanes) for _ in range(9)] for _ in range(2)]
    _, _, lit, every = dr.while_loop(
        (mi.UInt32(0), sampler, *start), lambda i, *_: i < limit, one_ray
    )
    share = dr.opaque(mi.Float, 1 / rays)
    return [s * share for s in lit], [s * share for s in every]


def basis(directions: Any) -> list[Any]:
    """The first nine real harmonics at ``directions``."""
    x, y, z = directions.x, directions.y, directions.z
    return [
        x * 0 + 0.28209479,
        0.48860251 * y,
        0.48860251 * z,
        0.48860251 * x,
        1.09254843 * (x * y),
        1.09254843 * (y * z),
        0.31539157 * (3 * z * z - 1),
        1.09254843 * (x * z),
        0.54627422 * (x * x - y * y),
    ]
