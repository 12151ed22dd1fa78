"""What the errors are measured against: some of a scene's points, traced with very many rays.

Two halves with azimuths of their own, summed over local directions in float64, each point turned
with the basis' exact rotation.  None of the engine's corrections or skips are in it.
"""

import hashlib
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from prt_baker.addon.prt import sh
from prt_baker.addon.prt.parallel import available_cores
from prt_baker.addon.prt.tracing.hemisphere import cosine_fibonacci, frames
from prt_baker.addon.prt.tracing.rays import Occlusion, occlusion
from prt_baker.addon.prt.tracing.transfer import relative_rms
from scenes import Scene

Array = np.ndarray

ORDER = 3
RAYS = 65536  # a point and half
SEED = 20
OPEN = 0.5 * np.pi**-0.5  # the first coefficient under the whole sky
DARK = 1 / 256  # of it


@dataclass(frozen=True)
class Reference:
    """``transfer`` (K, n²) float64 at the scene's points ``chosen`` (K,), which belong to
    ``receiver`` (K,) and stand for ``weight`` (K,) points each; and its own relative RMS error,
    from the difference of its halves."""

    chosen: Array
    transfer: Array
    receiver: Array
    weight: Array
    error: float

    def error_of(self, values: Array) -> float:
        """Relative RMS error of ``values`` (K, n²) at the chosen points."""
        return self.rms(values - self.transfer)

    def rms(self, difference: Array) -> float:
        """Root of the mean square of ``difference`` (K, n²), relative to the transfer's."""
        return weighted_rms(difference, self.weight) / weighted_rms(self.transfer, self.weight)

    def of_receiver(self, number: int) -> "Reference":
        """Only the points of one receiver."""
        its = self.receiver == number
        rest = (getattr(self, name)[its] for name in ("chosen", "transfer", "receiver", "weight"))
        return Reference(*rest, self.error)


def weighted_rms(values: Array, weight: Array) -> float:
    """Root of the weighted mean square of the rows of ``values`` (K, n²)."""
    return float(np.average(np.square(values).mean(axis=1), weights=weight) ** 0.5)


def reference(scene: Scene, count: int, cache: Path) -> Reference:
    """At ``count`` random points of ``scene``, as many on each receiver, read from ``cache`` where
    it is already there.

    Points that see next to no sky are left out: nobody errs there, and the engine gives those that
    lie inside of something their neighbours' values on purpose.
    """
    chosen, receiver, weight = choose(scene, count)
    file = cache / f"reference-{scene.name}-{_key(scene, chosen)}.npz"
    if not file.exists():
        sky = occlusion(scene.centred.occluder_vertices, scene.centred.occluder_triangles)
        starts, normals = scene.origins[chosen], scene.normals[chosen]
        halves = [half(starts, normals, sky, seed) for seed in (SEED, SEED + 1)]
        file.parent.mkdir(parents=True, exist_ok=True)
        np.savez(file, halves=halves)
    first, second = np.load(file)["halves"]
    lit = (first + second)[:, 0] > DARK * 2 * OPEN
    transfer = 0.5 * (first + second)[lit]
    error = 0.5 * relative_rms(first[lit], second[lit])
    return Reference(chosen[lit], transfer, receiver[lit], weight[lit], error)


def choose(scene: Scene, count: int) -> tuple[Array, Array, Array]:
    """Places (K,) of random points, their receivers, and how many points each stands for."""
    random = np.random.default_rng(SEED)
    share, before = count // len(scene.points), 0
    chosen, receiver, weight = [], [], []
    for number, points in enumerate(scene.points):
        there = len(points.origins)
        size = min(share, there)
        chosen.append(before + np.sort(random.choice(there, size, replace=False)))
        receiver.append(np.full(size, number))
        weight.append(np.full(size, there / size))
        before += there
    return np.concatenate(chosen), np.concatenate(receiver), np.concatenate(weight)


def _key(scene: Scene, chosen: Array) -> str:
    job = scene.centred
    arrays = (job.occluder_vertices, job.occluder_triangles, scene.origins, scene.normals, chosen)
    digest = hashlib.blake2b(f"{RAYS} {SEED}".encode(), digest_size=8)
    for array in arrays:
        digest.update(np.ascontiguousarray(array))
    return digest.hexdigest()


def half(origins: Array, normals: Array, sky: Occlusion, seed: int) -> Array:
    """Transfer (K, n²) at ``origins`` (K, 3) about ``normals`` (K, 3)."""
    local = cosine_fibonacci(RAYS)
    values = sh.basis(local, ORDER) / RAYS
    azimuth = np.random.default_rng(seed).random(len(origins)) * 2 * np.pi
    matrices = frames(normals, azimuth).matrices().astype(np.float64)

    def transfer(p: int) -> Array:
        directions = (local @ matrices[p].T).astype(np.float32)
        mask = sky.sky_mask(np.broadcast_to(origins[p], directions.shape), directions)
        turn = sh.rotation_matrix(matrices[p], ORDER)
        return turn @ ((mask != 0).astype(np.float64) @ values)

    with ThreadPoolExecutor(available_cores()) as pool:
        return np.array(list(pool.map(transfer, range(len(origins)))))
