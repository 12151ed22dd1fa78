"""Scenes of known shape, as the arrays that the engine reads."""

import numpy as np
from prt_baker.addon.prt.job import Receiver


def receiver(vertices, triangles, normals=None, name="shape"):
    """A mesh with flat CORNER normals, or POINT domain where vertex ``normals`` are given."""
    vertices = np.asarray(vertices, np.float64)
    triangles = np.asarray(triangles, np.int32)
    corners = np.arange(triangles.size, dtype=np.int32).reshape(-1, 3)
    domain = "CORNER" if normals is None else "POINT"
    if normals is None:
        sides = vertices[triangles]
        cross = np.cross(sides[:, 1] - sides[:, 0], sides[:, 2] - sides[:, 0])
        length = np.linalg.norm(cross, axis=1, keepdims=True)
        normals = np.repeat(cross / np.where(length > 0, length, 1), 3, axis=0)
    return Receiver(
        name,
        domain,
        vertices.astype(np.float32),
        triangles,
        corners,
        triangles.reshape(-1),
        np.asarray(normals, np.float32),
    )


def join(*meshes):
    """One (vertices, triangles) of several."""
    offsets = np.cumsum([0] + [len(vertices) for vertices, _ in meshes])
    vertices = np.concatenate([vertices for vertices, _ in meshes])
    triangles = [t + offset for (_, t), offset in zip(meshes, offsets[:-1], strict=True)]
    return vertices, np.concatenate(triangles).astype(np.int32)


def grid(origin, u, v, count):
    """A rectangle from ``origin`` along ``u`` and ``v``, count² quads, facing u x v."""
    s, t = np.meshgrid(np.linspace(0, 1, count + 1), np.linspace(0, 1, count + 1), indexing="ij")
    vertices = np.asarray(origin) + s[..., None] * np.asarray(u) + t[..., None] * np.asarray(v)
    corner = (np.arange(count)[:, None] * (count + 1) + np.arange(count)).reshape(-1)
    right, up = corner + count + 1, corner + 1
    triangles = np.concatenate(
        [np.stack([corner, right, right + 1], 1), np.stack([corner, right + 1, up], 1)]
    )
    return vertices.reshape(-1, 3), triangles


def wrapped(surface, rows, columns):
    """Triangles of a (rows, columns) grid of vertices that closes in both directions."""
    i, j = np.meshgrid(np.arange(rows), np.arange(columns), indexing="ij")
    k, m = (i + 1) % rows, (j + 1) % columns
    a, b, c, d = (x.reshape(-1) for x in (i * columns + j, k * columns + j, k * columns + m,
                                          i * columns + m))  # fmt: skip
    triangles = np.concatenate([np.stack([a, b, c], 1), np.stack([a, c, d], 1)])
    return surface.reshape(-1, 3), triangles


def torus_knot(rows=600, columns=24, radius=0.28):
    """A (2, 3) torus knot's vertices, triangles and smooth normals."""
    t = np.linspace(0, 2 * np.pi, rows, endpoint=False)

    def curve(t):
        ring = 1 + 0.5 * np.cos(3 * t)
        return np.stack([ring * np.cos(2 * t), ring * np.sin(2 * t), 0.5 * np.sin(3 * t)], -1)

    tangent = curve(t + 1e-4) - curve(t - 1e-4)
    tangent /= np.linalg.norm(tangent, axis=1, keepdims=True)
    side = np.cross(tangent, curve(t))
    side /= np.linalg.norm(side, axis=1, keepdims=True)
    up = np.cross(side, tangent)
    angle = np.linspace(0, 2 * np.pi, columns, endpoint=False)[None, :, None]
    normals = np.cos(angle) * side[:, None] + np.sin(angle) * up[:, None]
    vertices, triangles = wrapped(curve(t)[:, None] + radius * normals, rows, columns)
    corners = vertices[triangles]
    facing = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    if (facing * normals.reshape(-1, 3)[triangles[:, 0]]).sum() < 0:
        triangles = triangles[:, ::-1]
    return vertices, triangles, normals.reshape(-1, 3)


def knot_scene(rows=600, columns=24):
    """The torus knot over a floor and before a wall: receiver, occluder vertices, triangles."""
    vertices, triangles, normals = torus_knot(rows, columns)
    floor = grid([-2.5, -2.5, -1], [5, 0, 0], [0, 5, 0], 100)
    wall = grid([-2.5, 1.9, -1], [5, 0, 0], [0, 0, 4], 80)
    everything = join((vertices, triangles), floor, wall)
    return receiver(vertices, triangles, normals, "knot"), *everything


def sphere(rows=64, columns=128, radius=1.0):
    """A UV sphere without poles cut out: vertices, triangles, smooth normals."""
    theta = np.pi * (np.arange(rows) + 0.5) / rows
    phi = 2 * np.pi * np.arange(columns) / columns
    st, ct = np.sin(theta)[:, None], np.cos(theta)[:, None] * np.ones_like(phi)
    normals = np.stack([st * np.cos(phi), st * np.sin(phi), ct], -1)
    i, j = np.meshgrid(np.arange(rows - 1), np.arange(columns), indexing="ij")
    m = (j + 1) % columns
    a, b = i * columns + j, (i + 1) * columns + j
    c, d = (i + 1) * columns + m, i * columns + m
    quads = [x.reshape(-1) for x in (a, b, c, d)]
    triangles = np.concatenate([np.stack(quads[:3], 1), np.stack([quads[0], *quads[2:]], 1)])
    normals = normals.reshape(-1, 3)
    return radius * normals, triangles, normals


def box(size=2.0, count=8, inward=True):
    """A closed box about the origin, its faces gridded, seen from inside or outside."""
    h, s = size / 2, size
    sides = []
    for axis in range(3):
        u, v = np.zeros(3), np.zeros(3)
        u[(axis + 1) % 3], v[(axis + 2) % 3] = s, s
        for sign in (-1, 1):
            origin = np.full(3, -h)
            origin[axis] = sign * h
            outward = (u, v) if sign > 0 else (v, u)
            first, second = outward[::-1] if inward else outward
            sides.append(grid(origin, first, second, count))
    return join(*sides)
