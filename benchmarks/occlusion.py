"""What the occlusion of reflections is worth: a ball before a black wall.

Prints a table in Markdown.  What the ball reflects of an HDRI with its whole BRDF (white metal),
texel by texel, against the same without the wall times a factor: 1, the share of the
cosine-weighted sky that is seen (ambient occlusion), the share of the lobe that the baked
visibility sees, and that share blended with the diffuse light's (order 3).  Relative RMS over what
cameras on three sides see, the mean of Blender's HDRIs.
"""

import argparse
import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from prt_baker.addon.prt import sh
from prt_baker.addon.prt.files import images
from prt_baker.addon.prt.job import Settings
from prt_baker.addon.prt.light import lat_long
from prt_baker.addon.prt.light.projection import repair
from prt_baker.addon.prt.specular import brdf, occlusion, shading
from prt_baker.addon.prt.specular.sheet import zonal_factors
from prt_baker.addon.prt.surface.points import Points
from prt_baker.addon.prt.tracing.rays import occlusion as embree
from prt_baker.addon.prt.tracing.transfer import relative_rms, trace_all

sys.path.insert(0, str(Path(__file__).parents[1] / "tests" / "engine"))
import shapes

Array = np.ndarray

HDRIS = ("city", "courtyard", "forest", "interior", "night", "studio", "sunrise", "sunset")
ORDER = 3  # of the transfer
ORDERS = (2, 3, 4, 5)  # of the visibility
ROUGHNESSES = (0.2, 0.4, 0.6, 0.8, 1.0)
AWAY, SIDE = 1.4, 6.0  # the wall's distance from the ball's centre, and its sides, in radii
CAMERAS = ([0.0, -1, 0.2], [0.3, 1, 0.3], [1.0, 0.3, 0.5])  # directions towards them
POINTS = 700  # on the ball
NAMES = ("none", "ambient occlusion", "the lobe alone, order 3", *(f"order {n}" for n in ORDERS))


def main() -> None:
    """The table."""
    asked = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    asked.add_argument("--hdri", nargs="+", default=HDRIS)
    asked.add_argument("--rays", type=int, default=256)
    chosen = asked.parse_args()
    pixels = [picture(name) for name in chosen.hdri]
    print("| roughness |", " | ".join(f"{name}, %" for name in NAMES), "|")
    print("|---" * (1 + len(NAMES)) + "|")
    ball = Ball(chosen.rays, pixels[0].shape[:2])
    for roughness in ROUGHNESSES:
        errors = np.mean(ball.errors(pixels, roughness), axis=0)
        print(f"| {roughness} | {' | '.join(f'{100 * e:.1f}' for e in errors)} |", flush=True)


class Ball:
    """Places on the ball that a camera sees, unit ``normals`` (P, 3) and directions ``towards`` it
    (P, 3), what is baked there with so many ``rays``, and which texels of pictures of ``shape``
    reach them, all below the ball's own horizon included."""

    def __init__(self, rays: int, shape: tuple[int, int]) -> None:
        cameras = np.array(CAMERAS) / np.linalg.norm(CAMERAS, axis=1, keepdims=True)
        place, camera = np.nonzero(even_sphere(POINTS) @ cameras.T > 0)
        self.normals, self.towards = even_sphere(POINTS)[place], cameras[camera]
        corner = [-AWAY, -SIDE / 2, -1]
        wall = embree(*shapes.grid(corner, [0, SIDE, 0], [0, 0, SIDE], 1))
        starts = np.float32(self.normals)
        values = np.empty((len(place), ORDER**2 + max(ORDERS) ** 2), np.float32)
        steps = trace_all(
            Points(starts, starts, np.empty(0, np.int32)),
            wall,
            Settings(order=ORDER, rays=rays),
            values,
            visibility_order=max(ORDERS),
        )
        for _ in steps:
            pass
        self.transfer, self.visibility_sh = values[:, None, : ORDER**2], values[:, ORDER**2 :]
        self.texels = np.float32(lat_long.directions(*shape).reshape(-1, 3))
        self.solid_angles = np.repeat(lat_long.row_solid_angles(*shape), shape[1])
        self.clear = np.empty((len(place), len(self.texels)), bool)
        for sees, normal, start in zip(self.clear, self.normals, starts, strict=True):
            met = wall.sky_mask(np.broadcast_to(start, self.texels.shape), self.texels) == 0
            sees[:] = ~(met & (self.texels @ normal > 0))

    def reflected(self, flux: Array, roughness: float) -> tuple[Array, Array]:
        """What is reflected of texels with ``flux`` (M, K) without the wall and with it (P, K)."""
        k = brdf.environment_k(roughness)
        whole = np.empty((len(self.normals), flux.shape[1]))
        shadowed = np.empty_like(whole)
        for i, (normal, towards) in enumerate(zip(self.normals, self.towards, strict=True)):
            above = np.flatnonzero(self.texels @ normal > 0)
            halves = self.texels[above] + towards
            n_l, n_h = self.texels[above] @ normal, halves @ normal
            lobe = brdf.distribution(roughness**2, n_h / np.linalg.norm(halves, axis=1)) * n_l
            lobe *= brdf.visible_part(k, n_l) * brdf.visible_part(k, normal @ towards) / 4
            whole[i] = lobe @ flux[above]
            shadowed[i] = (lobe * self.clear[i, above]) @ flux[above]
        return whole, shadowed

    def errors(self, pictures: list[Array], roughness: float) -> list[list[float]]:
        """Of the factors of ``NAMES``, relative to what is reflected under each of ``pictures``
        (H, W, 3)."""
        flux = [p.reshape(-1, 3) * self.solid_angles[:, None] for p in pictures]
        both = self.reflected(np.concatenate(flux, axis=1), roughness)
        light = [f.T @ sh.basis(self.texels, ORDER) for f in flux]
        parts = zip(*(np.split(one, len(pictures), axis=1) for one in both), light, strict=True)
        return [
            [relative_rms(factor * whole, shadowed) for factor in self.factors(lit.T, roughness)]
            for whole, shadowed, lit in parts
        ]

    def factors(self, radiance_sh: Array, roughness: float) -> Iterator[Array]:
        """Those of ``NAMES``, (P, 1 or 3) or 1."""
        open_sky = sh.open_transfer([0.0, 0, 1], 1)
        lobes = [self.lobe(order, roughness) for order in ORDERS]
        light = occlusion.brightened(radiance_sh, ORDER)
        arriving = occlusion.arriving(self.transfer, self.normals, light)
        yield np.ones((1, 1))
        yield self.transfer[:, 0, :1] / open_sky
        yield lobes[ORDERS.index(3)][:, None]
        for lobe in lobes:
            yield occlusion.share(lobe, arriving, roughness)

    def lobe(self, order: int, roughness: float) -> Array:
        """The share (P,) of the lobe that a visibility of ``order`` sees."""
        directions, filtered = shading.look_up(self.normals, self.towards, roughness)
        seen = self.visibility_sh[:, : order**2]
        return occlusion.occlusion(seen, directions, zonal_factors(filtered))


def even_sphere(count: int) -> Array:
    """Unit directions (N, 3) of equal solid angle."""
    i = np.arange(count)
    z, phi = 1 - (2 * i + 1) / count, i * np.pi * (3 - 5**0.5)
    radius = np.sqrt(1 - z * z)
    return np.stack([radius * np.cos(phi), radius * np.sin(phi), z], axis=1)


def picture(name: str) -> Array:
    """One of Blender's HDRIs (H, W, 3), a quarter as wide and high."""
    import bpy

    folder = Path(bpy.utils.system_resource("DATAFILES")) / "studiolights" / "world"
    pixels, _ = repair(images.read(str(folder / f"{name}.exr")))
    height, width = pixels.shape[0] // 4, pixels.shape[1] // 4
    return pixels.reshape(height, 4, width, 4, 3).mean(axis=(1, 3))


if __name__ == "__main__":
    main()
