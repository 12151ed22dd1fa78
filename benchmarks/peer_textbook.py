"""The bake of the textbooks: Monte Carlo in numpy, with embreex.

Random cosine-weighted directions, a ray each, the basis evaluated for every ray, one batch after
another on every thread.  Written as well as plain numpy allows: float32, polynomials, only the rays
that reach the sky are summed.
"""

import time
from concurrent.futures import ThreadPoolExecutor
from importlib.metadata import version

import numpy as np
from peers import Traced, World
from prt_baker.addon.prt.tracing.rays import Occlusion, occlusion

Array = np.ndarray

BATCH_RAYS = 65536
state: tuple[World, Occlusion]


def versions() -> dict[str, str]:
    """Of what it is made of."""
    return {name: version(name) for name in ("numpy", "embreex")}


def prepare(world: World) -> float:
    """Build Embree's structure; seconds."""
    global state  # noqa: PLW0603 - one scene at a time in this process
    start = time.perf_counter()
    state = (world, occlusion(world.vertices, world.triangles))
    return time.perf_counter() - start


def trace(_method: str, rays: int, seed: int) -> Traced:
    """Transfer of every point with ``rays`` rays each."""
    world, sky = state
    size = max(1, BATCH_RAYS // rays)
    batches = [slice(i, i + size) for i in range(0, len(world.origins), size)]
    transfer = np.empty((len(world.origins), 9), np.float32)

    def bake(number: int) -> None:
        part = batches[number]
        random = np.random.default_rng([seed, number])
        transfer[part] = bake_batch(world.origins[part], world.normals[part], sky, rays, random)

    start = time.perf_counter()
    with ThreadPoolExecutor(world.threads) as pool:
        list(pool.map(bake, range(len(batches))))
    return Traced(time.perf_counter() - start, transfer)


def bake_batch(
    origins: Array, normals: Array, sky: Occlusion, rays: int, random: np.random.Generator
) -> Array:
    """Transfer (P, 9) of some points."""
    tangent, bitangent = axes(normals)
    u, v = random.random((2, len(origins), rays), np.float32)
    radius, phi = np.sqrt(u), np.float32(2 * np.pi) * v
    x, y, z = radius * np.cos(phi), radius * np.sin(phi), np.sqrt(1 - u)
    directions = (
        x[..., None] * tangent[:, None]
        + y[..., None] * bitangent[:, None]
        + z[..., None] * normals[:, None]
    )
    starts = np.repeat(origins, rays, axis=0)
    mask = sky.sky_mask(starts, directions.reshape(-1, 3)).reshape(len(origins), rays)
    values = basis(directions) * (mask != 0)
    return values.sum(axis=2).T / np.float32(rays)


def axes(normals: Array) -> tuple[Array, Array]:
    """Two unit vectors (P, 3) each that stand on ``normals`` (P, 3) and on each other; Duff et al.
    2017, Building an orthonormal basis, revisited."""
    x, y, z = normals.T
    sign = np.where(z < 0, np.float32(-1), np.float32(1))
    a = -1 / (sign + z)
    b = x * y * a
    tangent = np.stack([1 + sign * x * x * a, sign * b, -sign * x], axis=1)
    return tangent, np.stack([b, sign + y * y * a, -y], axis=1)


def basis(directions: Array) -> Array:
    """The first nine real harmonics (9, P, N) at ``directions`` (P, N, 3)."""
    x, y, z = np.moveaxis(directions, -1, 0)
    values = np.empty((9, *x.shape), np.float32)
    values[0] = 0.28209479
    values[1:4] = 0.48860251 * y, 0.48860251 * z, 0.48860251 * x
    values[4:6] = 1.09254843 * (x * y), 1.09254843 * (y * z)
    values[6] = 0.31539157 * (3 * z * z - 1)
    values[7] = 1.09254843 * (x * z)
    values[8] = 0.54627422 * (x * x - y * y)
    return values
