"""What the occlusion of reflections is worth: a ball before a black wall.

Prints a table in Markdown.  What GGX lobes on the ball gather of an HDRI, ray by ray, against the
same without the wall times a factor: 1, the share of the cosine-weighted sky that is seen (ambient
occlusion), and the share of the lobe that the baked visibility sees.  Relative RMS over what
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
from prt_baker.addon.prt.light.projection import repair
from prt_baker.addon.prt.specular import brdf
from prt_baker.addon.prt.specular.occlusion import occlusion
from prt_baker.addon.prt.specular.sheet import zonal_factors
from prt_baker.addon.prt.surface.points import Points
from prt_baker.addon.prt.tracing.hemisphere import frames
from prt_baker.addon.prt.tracing.rays import occlusion as embree
from prt_baker.addon.prt.tracing.transfer import relative_rms, trace_all

sys.path.insert(0, str(Path(__file__).parents[1] / "tests" / "engine"))
import shapes

Array = np.ndarray

HDRIS = ("city", "courtyard", "forest", "interior", "night", "studio", "sunrise", "sunset")
ORDERS = (2, 3, 4, 5)
ROUGHNESSES = (0.2, 0.4, 0.6, 0.8, 1.0)
AWAY, SIDE = 1.4, 6.0  # the wall's distance from the ball's centre, and its sides, in radii
CAMERAS = ([0.0, -1, 0.2], [0.3, 1, 0.3], [1.0, 0.3, 0.5])  # directions towards them
POINTS, LOBE = 1500, 1024  # on the ball; directions of a lobe


def main() -> None:
    """The table."""
    asked = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    asked.add_argument("--hdri", nargs="+", default=HDRIS)
    asked.add_argument("--rays", type=int, default=256)
    chosen = asked.parse_args()
    pixels = [picture(name) for name in chosen.hdri]
    names = ["none", "ambient occlusion", *(f"visibility, order {n}" for n in ORDERS)]
    print("| roughness |", " | ".join(f"{name}, %" for name in names), "|")
    print("|---" * (1 + len(names)) + "|")
    ball = Ball(chosen.rays)
    for roughness in ROUGHNESSES:
        lobes = ball.lobes(roughness)
        errors = [list(ball.errors(each, lobes, roughness)) for each in pixels]
        row = " | ".join(f"{100 * error:.1f}" for error in np.mean(errors, axis=0))
        print(f"| {roughness} | {row} |", flush=True)


class Ball:
    """Places on the ball that a camera sees: unit ``normals`` (P, 3), ``mirrored`` directions
    (P, 3), and what is baked there with so many ``rays``."""

    def __init__(self, rays: int) -> None:
        towards = np.array(CAMERAS) / np.linalg.norm(CAMERAS, axis=1, keepdims=True)
        everywhere = even_sphere(POINTS)
        facing = everywhere @ towards.T
        place, camera = np.nonzero(facing > 0)
        self.normals = everywhere[place]
        self.mirrored = 2 * facing[place, camera, None] * self.normals - towards[camera]
        places = Points(np.float32(self.normals), np.float32(self.normals), np.empty(0, np.int32))
        corner = [-AWAY, -SIDE / 2, -1]
        self.wall = embree(*shapes.grid(corner, [0, SIDE, 0], [0, 0, SIDE], 1))
        values = np.empty((len(place), 1 + max(ORDERS) ** 2), np.float32)
        settings = Settings(order=1, rays=rays)
        for _ in trace_all(places, self.wall, settings, values, visibility_order=max(ORDERS)):
            pass
        self.ambient = values[:, :1] / sh.open_transfer([0.0, 0, 1], 1)
        self.visibility_sh = values[:, 1:]

    def lobes(self, roughness: float) -> tuple[Array, Array]:
        """Directions (P, N, 3) of the lobes, and which of them reach the sky (P, N), all below the
        ball's own horizon included."""
        local = lobe_directions(roughness)
        turn = frames(self.mirrored, np.linspace(0, 2 * np.pi, len(self.mirrored))).matrices()
        directions = np.einsum("pij,nj->pni", turn, np.float32(local))
        above = np.einsum("pni,pi->pn", directions, self.normals) > 0
        starts = np.repeat(np.float32(self.normals), len(local), axis=0)
        blocked = self.wall.sky_mask(starts, directions.reshape(-1, 3)).reshape(above.shape) == 0
        return directions, ~(above & blocked)

    def errors(
        self, pixels: Array, lobes: tuple[Array, Array], roughness: float
    ) -> Iterator[float]:
        """Of the factors, relative to what is reflected under ``pixels`` (H, W, 3)."""
        directions, clear = lobes
        radiance = looked_up(pixels, directions)
        whole = radiance.mean(axis=1)
        shadowed = (radiance * clear[..., None]).mean(axis=1)
        factors = zonal_factors(roughness)
        yield relative_rms(whole, shadowed)
        yield relative_rms(self.ambient * whole, shadowed)
        for order in ORDERS:
            seen = occlusion(self.visibility_sh[:, : order**2], self.mirrored, factors)
            yield relative_rms(seen[:, None] * whole, shadowed)


def lobe_directions(roughness: float) -> Array:
    """Directions (N, 3) about +z, as dense as the lobe."""
    angle = np.linspace(0, np.pi / 2, 20_001)
    density = brdf.lobe(roughness, np.cos(angle)) * np.sin(angle)
    reached = np.concatenate([[0], np.cumsum(0.5 * (density[1:] + density[:-1]))])
    i = np.arange(LOBE)
    theta = np.interp((i + 0.5) / LOBE, reached / reached[-1], angle)
    phi = i * np.pi * (3 - 5**0.5)
    return np.stack([np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta)], 1)


def even_sphere(count: int) -> Array:
    """Unit directions (N, 3) of equal solid angle."""
    i = np.arange(count)
    z, phi = 1 - (2 * i + 1) / count, i * np.pi * (3 - 5**0.5)
    radius = np.sqrt(1 - z * z)
    return np.stack([radius * np.cos(phi), radius * np.sin(phi), z], axis=1)


def looked_up(pixels: Array, directions: Array) -> Array:
    """The picture's texels (..., 3) in unit ``directions`` (..., 3)."""
    height, width = pixels.shape[:2]
    u = 0.5 - np.arctan2(directions[..., 1], directions[..., 0]) / (2 * np.pi)
    v = np.arccos(np.clip(directions[..., 2], -1, 1)) / np.pi
    row = np.minimum((v * height).astype(int), height - 1)
    return pixels[row, (u * width).astype(int) % width]


def picture(name: str) -> Array:
    """One of Blender's HDRIs (H, W, 3), a quarter as wide and high."""
    import bpy

    folder = Path(bpy.utils.system_resource("DATAFILES")) / "studiolights" / "world"
    pixels, _ = repair(images.read(str(folder / f"{name}.exr")))
    height, width = pixels.shape[0] // 4, pixels.shape[1] // 4
    return pixels.reshape(height, 4, width, 4, 3).mean(axis=(1, 3))


if __name__ == "__main__":
    main()
