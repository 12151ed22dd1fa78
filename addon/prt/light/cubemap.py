"""Cubemaps: their faces, layouts, exact solid angles and spherical harmonics.

Faces stand in the order +X, -X, +Y, -Y, +Z, -Z of OpenGL and DirectX, top row first, each as it is
seen from inside: nothing is mirrored.  Their frame has +Y up, +Z ahead and +X to the right
(left-handed, as those two define it).  Here +Z becomes Blender's +Y (ahead) and
+Y Blender's +Z (up); +X stays.  Layouts, N pixels a face:

    horizontal cross 4 N x 3 N    vertical cross 3 N x 4 N    strips 6 N x N and N x 6 N
         +Y                            +Y
      -X +Z +X -Z                   -X +Z +X                  the six faces in order
         -Y                            -Y
                                       -Z (turned by 180°)

The corners of a cross are not read.
"""

from collections.abc import Iterator

import numpy as np
import numpy.typing as npt

from .. import sh
from . import lat_long

Float = npt.NDArray[np.float64]
Pixels = npt.NDArray[np.float32]

# Right, down and ahead of each face, in Blender's axes
_RIGHT = ((0, -1, 0), (0, 1, 0), (1, 0, 0), (1, 0, 0), (1, 0, 0), (-1, 0, 0))
_DOWN = ((0, 0, -1), (0, 0, -1), (0, 1, 0), (0, -1, 0), (0, 0, -1), (0, 0, -1))
_AHEAD = ((1, 0, 0), (-1, 0, 0), (0, 0, 1), (0, 0, -1), (0, 1, 0), (0, -1, 0))
FRAMES = np.stack([_RIGHT, _DOWN, _AHEAD], axis=-1).astype(np.float64)  # (6, 3, 3), columns

# Width and height in faces: row and column of each face
_LAYOUTS = {
    (4, 3): ((1, 2), (1, 0), (0, 1), (2, 1), (1, 1), (1, 3)),
    (3, 4): ((1, 2), (1, 0), (0, 1), (2, 1), (1, 1), (3, 1)),
    (6, 1): tuple((0, k) for k in range(6)),
    (1, 6): tuple((k, 0) for k in range(6)),
}
LAT_LONG_ROWS = (256, 1024)  # of a cubemap as a lat-long map, at least and at most
DIRECTIONS = 1 << 14  # a chunk of them, times n² float64, stays in the cache


def is_cubemap(height: int, width: int) -> bool:
    """Whether a picture has the shape of one of the layouts."""
    return _layout(height, width) is not None


def to_faces(pixels: Pixels) -> Pixels:
    """The faces (6, N, N, 3) of a picture (H, W, 3) in a layout above; ValueError if in none."""
    layout = _layout(*pixels.shape[:2])
    if layout is None:
        raise ValueError(f"{pixels.shape[1]} x {pixels.shape[0]} is no layout of a cubemap")
    size = pixels.shape[1] // layout[0]
    faces = [
        pixels[row * size : (row + 1) * size, column * size : (column + 1) * size]
        for row, column in _LAYOUTS[layout]
    ]
    if layout == (3, 4):
        faces[5] = faces[5][::-1, ::-1]
    return np.stack(faces)


def directions(face: int, size: int) -> Float:
    """Unit directions (N, N, 3) of the centres of a face's texels, Blender's axes."""
    centre = (2 * np.arange(size) + 1) / size - 1
    return np.asarray(_normalised(centre[:, None], centre) @ FRAMES[face].T)


def solid_angles(size: int, rows: slice = slice(None)) -> Float:
    """Exact solid angles (rows, N) in steradians of the texels of some rows of a face.

    Differences of ``atan(x y / sqrt(x² + y² + 1))`` over the texel's corners, which must be
    float64: in float32 they are wrong by percents at 512² and negative at 4096².
    """
    edges = 2 * np.arange(size + 1, dtype=np.float64) / size - 1
    first, stop, _ = rows.indices(size)
    y = edges[first : stop + 1, None]
    corners = np.arctan(edges * y / np.sqrt(edges * edges + y * y + 1))
    return np.asarray(np.diff(np.diff(corners, axis=0), axis=1))


def project(faces: Pixels, order: int) -> Float:
    """Coefficients (n², 3) of a cubemap (6, N, N, 3): the integral of its pixels times the basis.

    A texel weighs its exact solid angle times the mean of the basis over it.  All faces share one
    table of the basis, in the frame of a face, and the sum of each is turned into its place.
    """
    size = faces.shape[1]
    rows = max(1, DIRECTIONS // (size * _nodes(size) ** 2))
    sums = np.zeros((order * order, 6, 3))
    for row in range(0, size, rows):
        part = slice(row, min(row + rows, size))
        table = _basis_integrals(size, part, order).reshape(-1, order * order)
        texels = faces[:, part].transpose(1, 2, 0, 3).reshape(-1, 18).astype(np.float64)
        sums += (table.T @ texels).reshape(-1, 6, 3)
    turned = [sh.rotate(sums[:, face], FRAMES[face]) for face in range(6)]
    return np.asarray(np.sum(turned, axis=0))


def to_lat_long(faces: Pixels) -> Pixels:
    """A cubemap (6, N, N, 3) as a lat-long map (H, 2 H, 3), H = 2 N within ``LAT_LONG_ROWS``.

    Each of its texels is the mean of the cubemap at some places in it.  The cubemap's texels are
    scaled by their exact solid angle over that of the places that found them, so that each gives
    the light that it has.
    """
    size = faces.shape[1]
    height = min(max(LAT_LONG_ROWS[0], 2 * size), LAT_LONG_ROWS[1])
    split = -(-max(2 * height, 8 * size) // height)
    shares = np.zeros(6 * size * size)
    for _, found, weights in _places_in_faces(height, split, size):
        shares += np.bincount(found.ravel(), weights.ravel(), len(shares))
    exact = np.tile(solid_angles(size).ravel(), 6)
    scale = np.divide(exact, shares, out=np.ones_like(shares), where=shares > 0)
    texels = faces.reshape(-1, 3) * scale[:, None]
    pixels = np.empty((height, 2 * height, 3), np.float32)
    for row, found, weights in _places_in_faces(height, split, size):
        light = texels[found] * (weights / weights.sum() * 2 * height)[..., None]
        pixels[row] = light.reshape(split, 2 * height, split, 3).sum(axis=(0, 2))
    return pixels


def _places_in_faces(
    height: int, split: int, size: int
) -> Iterator[tuple[int, npt.NDArray[np.int64], Float]]:
    """For each row of a lat-long map, ``split``² places in each of its texels: the texels of the
    cubemap that they lie in, as flat numbers, and their solid angles."""
    rows = height * split
    solid_angle = lat_long.row_solid_angles(rows, 2 * rows)
    phi = np.pi - (np.arange(2 * rows) + 0.5) * np.pi / rows
    around = np.stack([np.cos(phi), np.sin(phi), np.ones_like(phi)], axis=-1)
    for row in range(height):
        inside = np.arange(row * split, (row + 1) * split)
        theta = (inside + 0.5) * np.pi / rows
        sine = np.sin(theta)
        down = np.stack([sine, sine, np.cos(theta)], axis=-1)
        found = _texels_at((down[:, None] * around).reshape(-1, 3), size)
        yield (
            row,
            found.reshape(split, -1),
            np.repeat(solid_angle[inside], 2 * rows).reshape(split, -1),
        )


def _texels_at(directions: Float, size: int) -> npt.NDArray[np.int64]:
    """The texels, as flat numbers over all faces, that ``directions`` (D, 3) lie in."""
    largest = np.abs(directions).argmax(axis=1)
    negative = directions[np.arange(len(directions)), largest] < 0
    # the axes of FRAMES: +X, -X, +Z, -Z of Blender are faces 0 to 3, its +Y and -Y 4 and 5
    face = np.array([0, 4, 2])[largest] + negative
    local = np.einsum("dc,dck->dk", directions, FRAMES[face])
    place = (local[:, :2] / local[:, 2:] + 1) * (0.5 * size)
    column, row = np.clip(place.astype(np.int64), 0, size - 1).T
    return np.asarray((face * size + row) * size + column)


def _layout(height: int, width: int) -> tuple[int, int] | None:
    """Width and height in faces; None where the shape is no layout's."""
    for columns, rows in _LAYOUTS:
        size = width // columns
        if size and (width, height) == (columns * size, rows * size):
            return columns, rows
    return None


def _nodes(size: int) -> int:
    """Quadrature nodes along a texel's side: their error falls faster than the texel's."""
    return max(1, min(4, 1024 // size)) + 8 // size


def _basis_integrals(size: int, rows: slice, order: int) -> Float:
    """Integrals (rows, N, n²) of the basis over the texels of some rows, in the face's frame.

    Columns of ``FRAMES`` are the frame's x, y and z: right, down and ahead.
    """
    nodes, weights = np.polynomial.legendre.leggauss(_nodes(size))
    x = ((2 * np.arange(size)[:, None] + 1 + nodes) / size - 1).ravel()
    y = x.reshape(size, -1)[rows].ravel()
    values = sh.basis(_normalised(y[:, None], x), order)
    density = (1 + x * x + y[:, None] ** 2) ** -1.5
    shape = (len(y) // len(nodes), len(nodes), size, len(nodes))
    density = density.reshape(shape) * weights[:, None, None] * weights
    total = np.einsum("ajbk,ajbki->abi", density, values.reshape(*shape, -1))
    # the quadrature decides the basis's mean, the closed form the solid angle
    scale = solid_angles(size, rows) / density.sum(axis=(1, 3))
    return np.asarray(total * scale[..., None])


def _normalised(y: Float, x: Float) -> Float:
    """Unit vectors (..., 3) along (x, y, 1), in the frame of a face."""
    x, y = np.broadcast_arrays(x, y)
    vectors = np.stack([x, y, np.ones_like(x)], axis=-1)
    return np.asarray(vectors / np.sqrt(x * x + y * y + 1)[..., None])
