"""The exact light of the pictures that every Blender brings, beside all of their texels."""

from importlib.util import find_spec
from math import pi
from pathlib import Path

import numpy as np
import shapes
from prt_baker.addon.prt.files import images
from prt_baker.addon.prt.light import lat_long, projection
from prt_baker.addon.prt.light.exact import ExactLight
from prt_baker.addon.prt.surface import points, samples
from prt_baker.addon.prt.tracing import hemisphere, rays

HEIGHT, WIDTH = 128, 256  # texels of the pictures
EVEN_LIGHT = 3e-4  # of a picture: what the four rays of a texel answer for
SIDES = 2, 4, 8, 16, 32, 64, 128  # rays across a texel


def studio_lights():
    """Their files, found without importing bpy."""
    spec = find_spec("bpy")
    found = Path(spec.origin).parent.glob("*/datafiles/studiolights/world/*.exr") if spec else ()
    return sorted(found)


def small(file):
    """The picture of a ``file`` as means (HEIGHT, WIDTH, 3) of its texels."""
    pixels = projection.repair(images.read(str(file)))[0]
    height, width = pixels.shape[0] // HEIGHT, pixels.shape[1] // WIDTH
    return pixels.reshape(HEIGHT, height, WIDTH, width, 3).mean(axis=(1, 3))


def rays_about(normals, seed, count):
    """Cosines (N,) and directions (P, 3, N) of the transfer's own rays."""
    local = hemisphere.cosine_fibonacci(count).astype(np.float32)
    azimuth = np.random.default_rng([seed, 1]).random(len(normals)) * 2 * pi
    turned = hemisphere.frames(normals, azimuth).matrices()
    return np.ascontiguousarray(local[:, 2]), np.einsum("pij,nj->pin", turned, local)


def exit_radiance(exact, normals, visible, seed=0, count=64):
    """Of points whose visibility is the function ``visible`` of point numbers and directions."""
    cosines, directions = rays_about(normals, seed, count)
    picks = np.random.default_rng([seed, 2]).integers(0, 1 << 40, len(normals))
    drawn = exact.drawn(normals, picks)
    every = np.repeat(np.arange(len(normals)), count)
    in_rows = np.moveaxis(directions, 1, 2).reshape(-1, 3)
    seen = visible(every, in_rows).reshape(len(normals), count)
    map_seen = visible(drawn.point, drawn.directions)
    return exact.exit_radiance(normals, cosines, directions, seen, drawn, map_seen)


class Texels:
    """Directions in all texels: the more in a texel, the more light it has in one of ``pictures``,
    so that the outline of a shadow cuts through a lamp as finely as through the sky."""

    def __init__(self, pictures):
        angles = lat_long.row_solid_angles(HEIGHT, WIDTH)[:, None]
        flux = [picture.mean(axis=2) * angles for picture in pictures]
        share = np.max([light / light.sum() for light in flux], axis=0).reshape(-1)
        wanted = np.searchsorted(SIDES, 2 * np.sqrt(share / EVEN_LIGHT))
        sides = np.array(SIDES)[np.minimum(wanted, len(SIDES) - 1)]
        parts = [self._split(side, sides == side) for side in SIDES if (sides == side).any()]
        self.texels, self.directions, self.weights = (
            np.concatenate(column) for column in zip(*parts, strict=True)
        )

    @staticmethod
    def _split(side, chosen):
        """The texels that are ``chosen`` (HEIGHT * WIDTH,) in side x side parts: their numbers,
        directions and solid angles."""
        row, column = np.divmod(np.flatnonzero(chosen), WIDTH)
        down, right = np.divmod(np.arange(side * side), side)
        row, column = (row[:, None] * side + down), (column[:, None] * side + right)
        theta = (row + 0.5) * (pi / (HEIGHT * side))
        phi = pi - (column + 0.5) * (2 * pi / (WIDTH * side))
        towards = np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta)
        angles = lat_long.row_solid_angles(HEIGHT * side, WIDTH * side)[row]
        texels = np.repeat(np.flatnonzero(chosen), side * side)
        return texels, np.stack(towards, axis=-1).reshape(-1, 3).astype(np.float32), angles.ravel()


class OnTheKnot:
    """``count`` random places of the torus knot over floor and wall, and the exact exit radiance
    there (P, 3) under each of ``pictures``."""

    def __init__(self, count, pictures, seed=11):
        receiver, vertices, triangles = shapes.knot_scene()
        self.sky = rays.occlusion(vertices, triangles)
        surface = points.Surface.of(receiver)
        places = samples.random_places(surface.areas, count, seed)
        rows = points.element_triangles(receiver)
        found = samples.starts(surface, rows, receiver.normals, places)
        self.starts, self.normals = (values.astype(np.float32) for values in found)
        self.normals /= np.linalg.norm(self.normals, axis=1, keepdims=True)
        self.pictures, texels = pictures, Texels(pictures)
        light = np.concatenate([p.reshape(-1, 3) for p in pictures], axis=1).astype(np.float64)
        exact = np.array([self._weights(texels, place) @ light for place in range(count)])
        self.expected = np.moveaxis(exact.reshape(count, -1, 3), 1, 0) / pi

    def _weights(self, texels, place):
        """Cosine times visibility times solid angle (HEIGHT * WIDTH,) of all texels."""
        cosines = texels.directions @ self.normals[place]
        above = np.flatnonzero(cosines > 0)
        clear = self.seen(np.full(len(above), place), texels.directions[above])
        weights = cosines[above] * clear * texels.weights[above]
        return np.bincount(texels.texels[above], weights, HEIGHT * WIDTH)

    def seen(self, point, directions):
        """Visibility (R,) of ``directions`` (R, 3) from the places ``point`` (R,)."""
        towards = np.ascontiguousarray(directions, np.float32)
        return -self.sky.sky_mask(self.starts[point], towards).astype(np.float32)

    def error(self, picture, map_rays, count=256, seeds=3):
        """The relative RMS error under the picture of that number, of ``map_rays`` candidates and
        ``count`` of the transfer's rays; and the rays that are traced towards the map."""
        exact = ExactLight(self.pictures[picture], np.eye(3), (1, 1, 1), map_rays, 0)
        found = [exit_radiance(exact, self.normals, self.seen, s, count) for s in range(seeds)]
        expected = self.expected[picture]
        square = np.mean((np.array(found) - expected) ** 2)
        traced = len(exact.drawn(self.normals, np.arange(len(self.normals))).point)
        return float(np.sqrt(square / np.mean(expected**2))), traced / len(self.normals)
