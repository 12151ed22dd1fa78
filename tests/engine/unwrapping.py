"""Meshes to unwrap, and what their UV maps are measured by."""

from dataclasses import replace

import numpy as np
import shapes
from prt_baker.addon.prt.atlas import uv_map
from prt_baker.addon.prt.atlas.plane import plane_areas
from prt_baker.addon.prt.atlas.unwrap import unwrap
from prt_baker.addon.prt.job import Receiver
from prt_baker.addon.prt.steps import value_of
from prt_baker.addon.prt.surface.points import Surface


def unwrapped(*receivers, size=256, density=0.0, padding=2, threads=2):
    """The value of ``unwrap``."""
    steps = unwrap(receivers, size=size, density=density, padding=padding, threads=threads)
    return value_of(steps)


def of_quads(vertices, triangles, normals=None, name="quads"):
    """A mesh in which triangle i and triangle i + F / 2 are a polygon of four corners."""
    half = len(triangles) // 2
    base = shapes.receiver(vertices, triangles, normals, name)
    loops = np.empty((2 * half, 3), np.int32)
    first = 4 * np.arange(half, dtype=np.int32)
    loops[:half] = np.stack([first, first + 1, first + 2], 1)
    loops[half:] = np.stack([first, first + 2, first + 3], 1)
    corner_vertices = np.empty(4 * half, np.int32)
    corner_vertices[loops] = triangles
    if normals is not None:
        return replace(base, triangle_corners=loops, corner_vertices=corner_vertices)
    faces = Surface.of(base).normals
    mean = faces[:half] + faces[half:]
    mean /= np.linalg.norm(mean, axis=1, keepdims=True)
    return replace(
        base,
        triangle_corners=loops,
        corner_vertices=corner_vertices,
        normals=np.repeat(mean, 4, axis=0).astype(np.float32),
    )


def bumps(count=24, seed=0):
    """A sheet of uneven quads, smooth: no quad is flat."""
    vertices, triangles = shapes.grid([0, 0, 0], [1, 0, 0], [0, 1, 0], count)
    x, y = vertices[:, 0], vertices[:, 1]
    vertices[:, 2] = 0.3 * np.sin(9 * x) * np.cos(7 * y)
    vertices += 0.2 / count * np.random.default_rng(seed).standard_normal(vertices.shape)
    normals = np.tile([0, 0, 1.0], (len(vertices), 1))
    return vertices, triangles, normals


def places(receiver: Receiver, uvs):
    """UVs (F, 3, 2) of the triangles, float64."""
    return np.asarray(uvs, np.float64)[receiver.triangle_corners]


def shown_areas(corners):
    """Areas (F,) of triangles in the plane."""
    return np.abs(plane_areas(corners))


def charts_of(receiver, uvs):
    """The triangles of each chart."""
    chart = uv_map.charts(receiver, uvs)
    return [np.flatnonzero(chart == k) for k in range(chart.max() + 1)]


def outlines(receiver, uvs, size):
    """For each chart, points (N, 2) in texels, a quarter apart, along its triangles' sides."""
    corners = places(receiver, uvs) * size
    found = []
    for chart in charts_of(receiver, uvs):
        start = corners[chart].reshape(-1, 2)
        side = corners[chart][:, [1, 2, 0]].reshape(-1, 2) - start
        count = 2 + int(4 * np.hypot(*side.T).max())
        share = np.linspace(0, 1, count)[:, None, None]
        found.append((start + share * side).reshape(-1, 2))
    return found
