"""A room, as the arrays that the engine reads, and planar charts for what is made of flat faces."""

from itertools import product

import numpy as np
import shapes

WALL = 0.1  # metres: of the partition
HEIGHT, WIDTH, DEPTH = 2.8, 6.0, 4.0
PARTITION = 3.6  # where the partition stands


def cells(edges, solid):
    """The faces between cells that are ``solid`` and others, of a grid of boxes with ``edges``
    along x, y and z: (vertices, triangles), facing away from what is solid, and the cell that each
    triangle faces."""
    shape = tuple(len(e) for e in edges)
    vertices = np.stack(np.meshgrid(*edges, indexing="ij"), axis=-1).reshape(-1, 3)
    padded = np.pad(solid, 1)
    quads, cell = [], []
    for axis, sign in product(range(3), (-1, 1)):
        other = np.roll(padded, -sign, axis)[1:-1, 1:-1, 1:-1]
        at = np.argwhere(solid & ~other)
        corner = at.copy()
        corner[:, axis] += sign > 0
        steps = np.eye(3, dtype=int)[[(axis + 1) % 3, (axis + 2) % 3]][::sign]
        around = [corner, corner + steps[0], corner + steps[0] + steps[1], corner + steps[1]]
        quads.append(np.stack([np.ravel_multi_index(c.T, shape) for c in around], axis=1))
        faced = at.copy()
        faced[:, axis] += sign
        cell.append(faced)
    quads, cell = np.concatenate(quads), np.concatenate(cell)
    triangles = np.concatenate([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]])
    return vertices, triangles, np.concatenate([cell, cell])


def used(vertices, triangles):
    """Without the vertices that no triangle has."""
    kept, numbers = np.unique(triangles, return_inverse=True)
    return vertices[kept], numbers.reshape(triangles.shape)


def shell():
    """The inner faces of a room of two parts with a window, a partition and a door in it, and the
    outer faces."""
    edges = (
        [-0.2, 0, PARTITION, PARTITION + WALL, WIDTH, WIDTH + 0.2],
        [-0.2, 0, 0.9, 1.8, 3.0, DEPTH, DEPTH + 0.2],
        [-0.2, 0, 0.9, 2.1, HEIGHT, HEIGHT + 0.2],
    )
    solid = np.ones([len(e) - 1 for e in edges], bool)
    solid[1:-1, 1:-1, 1:-1] = False
    solid[2, 1:-1, 1:-1] = True
    solid[2, 2, 1:3] = False  # the door
    solid[0, 2:4, 2] = False  # the window, at the far side of the larger part
    vertices, triangles, faced = cells(edges, solid)
    outside = (faced < 0) | (faced >= np.array(solid.shape))
    outer = outside.any(axis=1)
    return used(vertices, triangles[~outer]), used(vertices, triangles[outer])


def block(low, high, turn=0.0, about=(0.0, 0.0)):
    """A box from ``low`` to ``high``, seen from outside, turned about a vertical line."""
    vertices, triangles, _ = cells([[a, b] for a, b in zip(low, high, strict=True)],
                                   np.ones((1, 1, 1), bool))  # fmt: skip
    c, s = np.cos(turn), np.sin(turn)
    flat = vertices[:, :2] - about
    vertices[:, :2] = flat @ np.array([[c, s], [-s, c]]) + about
    return vertices, triangles


def furniture():
    """A table, a cupboard in a corner, a bench, a shelf, a crate and the open door."""
    legs = [
        block((x, y, 0), (x + 0.06, y + 0.06, 0.72)) for x, y in product((1.2, 2.54), (1.3, 2.04))
    ]
    hinge = (PARTITION + WALL, 1.8)
    return [
        block((1.1, 1.2, 0.72), (2.7, 2.2, 0.76)),
        *legs,
        block((2.6, 3.4, 0), (3.6, 4.0, 1.9)),
        block((0.6, 3.2, -0.01), (2.0, 3.6, 0.42), 0.15, (1.3, 3.4)),
        block((4.2, 3.7, 1.2), (5.8, 4.0, 1.24)),
        block((4.6, 0.4, 0), (5.3, 1.0, 0.6), 0.4, (5, 0.7)),
        block((hinge[0], 1.76, 0.01), (hinge[0] + 0.86, 1.8, 2.08), -0.5, hinge),
    ]


def room():
    """A receiver with flat normals, and the vertices and triangles of all that casts shadows."""
    inner, outer = shell()
    seen = shapes.join(inner, *furniture())
    return shapes.receiver(*seen, name="room"), *shapes.join(seen, outer)


def planar_charts(receiver, size, padding=4):
    """uvs (C, 2) of ``receiver``, whose charts are its flat pieces, as large as they fit."""
    corners = receiver.vertices.astype(np.float64)[receiver.triangles]
    piece = flat_pieces(receiver)
    facing = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    facing /= np.linalg.norm(facing, axis=1, keepdims=True)
    flat, extents = np.empty((*receiver.triangles.shape, 2)), []
    for k in range(piece.max() + 1):
        mine = piece == k
        n = facing[mine][0]
        u = np.cross([0, 1, 0] if abs(n[2]) > 0.9 else [0, 0, 1], n)
        u /= np.linalg.norm(u)
        flat[mine] = corners[mine] @ np.stack([u, np.cross(n, u)], axis=1)
        flat[mine] -= flat[mine].min(axis=(0, 1))
        extents.append(flat[mine].max(axis=(0, 1)))
    low, high = 1.0, 64.0 * size
    for _ in range(30):
        scale = np.sqrt(low * high)
        low, high = (scale, high) if packed(extents, scale, size, padding)[1] else (low, scale)
    places, _ = packed(extents, low, size, padding)
    uvs = np.empty((len(receiver.corner_vertices), 2), np.float32)
    uvs[receiver.triangle_corners] = (flat * low + places[piece][:, None]) / size
    return uvs


def flat_pieces(receiver):
    """The flat piece (F,) that each triangle is in: joined over edges with equal normals."""
    normals = np.rint(receiver.normals[receiver.triangle_corners[:, 0]] * 1e4).astype(int)
    piece, changed = np.arange(len(receiver.triangles)), True
    by_vertex = np.full(len(receiver.vertices), 0)
    while changed:
        before = piece.copy()
        for n in np.unique(normals, axis=0):
            mine = (normals == n).all(axis=1)
            by_vertex[:] = len(piece)
            np.minimum.at(by_vertex, receiver.triangles[mine], piece[mine][:, None])
            piece[mine] = by_vertex[receiver.triangles[mine]].min(axis=1)
        changed = (piece != before).any()
    return np.unique(piece, return_inverse=True)[1]


def packed(extents, scale, size, padding):
    """Where rectangles lie on shelves (M, 2), in texels, and whether they fit into ``size``²."""
    places, x, y, shelf = np.zeros((len(extents), 2)), padding, padding, 0.0
    for k in np.argsort([-e[1] for e in extents], kind="stable"):
        width, height = extents[k] * scale
        if x + width + padding > size:
            x, y, shelf = padding, y + shelf + padding, 0.0
        places[k] = x, y
        x, shelf = x + np.ceil(width) + padding, max(shelf, np.ceil(height))
        if x > size:
            return places, False
    return places, y + shelf + padding <= size


def torus(rows=48, columns=24):
    """A smooth torus in two charts that lie turned in the atlas, one of them smaller: a receiver,
    its uvs (C, 2), and the vertices and triangles of it and of a floor."""
    around = 2 * np.pi * np.arange(rows) / rows
    across = 2 * np.pi * np.arange(columns) / columns
    a, b = np.meshgrid(around, across, indexing="ij")
    out = np.stack([np.cos(a), np.sin(a), np.zeros_like(a)], axis=-1)
    normals = np.cos(b)[..., None] * out + np.sin(b)[..., None] * np.array([0, 0, 1.0])
    vertices, triangles = shapes.wrapped(out + 0.45 * normals, rows, columns)
    receiver = shapes.receiver(vertices, triangles, normals.reshape(-1, 3), "torus")
    i, j = np.divmod(triangles, columns)
    i, j = (np.where(k.max(axis=1, keepdims=True) - k > n // 2, k + n, k)
            for k, n in ((i, rows), (j, columns)))  # fmt: skip
    upper = (i.min(axis=1) >= rows // 2)[:, None]
    s, t = (i - np.where(upper, rows // 2, 0)) / (rows / 2), j / columns
    first = np.stack([0.03 + 0.45 * t, 0.03 + 0.94 * s], axis=-1)
    second = np.stack([0.97 - 0.42 * s, 0.05 + 0.61 * t], axis=-1)
    uvs = np.where(upper[..., None], second, first).reshape(-1, 2).astype(np.float32)
    floor = shapes.grid([-3, -3, -0.6], [6, 0, 0], [0, 6, 0], 1)
    return receiver, uvs, *shapes.join((vertices, triangles), floor)
