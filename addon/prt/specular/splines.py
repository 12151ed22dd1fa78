"""Cubic B-splines in images: the coefficients that go through given values, and reads.

EEVEE's *Cubic* interpolation is the B-spline of what the texels hold, always of the full image.
"""

import numpy as np
import numpy.typing as npt

Float = npt.NDArray[np.float64]
GUTTER = 4  # texels beyond the nodes at both ends


def response(frequency: Float) -> Float:
    """What a spline makes of coefficients ``cos(frequency i)``, at the texels' centres."""
    return np.asarray((2 + np.cos(frequency)) / 3)


def through_nodes(values: npt.ArrayLike, axis: int) -> Float:
    """Coefficients of the natural spline through ``values`` along ``axis``, with
    ``GUTTER`` more beyond the first and the last node."""
    nodes = np.moveaxis(np.asarray(values, np.float64), axis, 0)
    count = len(nodes)
    system = np.eye(count)  # a natural spline's outermost coefficients are the values themselves
    inner = np.arange(1, count - 1)
    system[inner, inner] = 2 / 3
    system[inner, inner - 1] = system[inner, inner + 1] = 1 / 6
    flat = np.linalg.solve(system, nodes.reshape(count, -1)).reshape(nodes.shape)
    steps = np.arange(GUTTER, 0, -1).reshape(-1, *[1] * (nodes.ndim - 1))
    before = flat[0] - steps * (flat[1] - flat[0])
    after = flat[-1] + steps[::-1] * (flat[-1] - flat[-2])
    return np.moveaxis(np.concatenate([before, flat, after]), 0, axis)


def read(image: npt.ArrayLike, x: npt.ArrayLike, y: npt.ArrayLike) -> Float:
    """The spline with the coefficients ``image`` (H, W, K) at ``x``, ``y`` (P,) in texels, their
    centres at halves: (P, K).  Only texels inside may be touched."""
    coefficients = np.asarray(image)
    across, down = np.asarray(x, np.float64) - 0.5, np.asarray(y, np.float64) - 0.5
    column, row = np.floor(across).astype(np.int64), np.floor(down).astype(np.int64)
    horizontal, vertical = _weights(across - column), _weights(down - row)
    total = np.zeros((len(across), coefficients.shape[2]))
    for j in range(4):
        for i in range(4):
            weight = horizontal[i] * vertical[j]
            total += weight[:, None] * coefficients[row + j - 1, column + i - 1]
    return total


def _weights(t: Float) -> tuple[Float, Float, Float, Float]:
    """Of the four texels about a place that is ``t`` from the second to the third."""
    rest = 1 - t
    return (
        rest**3 / 6,
        (4 - 6 * t**2 + 3 * t**3) / 6,
        (4 - 6 * rest**2 + 3 * rest**3) / 6,
        t**3 / 6,
    )
