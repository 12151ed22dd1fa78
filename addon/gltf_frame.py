"""From Blender's frame (Z up) to glTF's (Y up): a direction (x, y, z) becomes (x, z, -y).

The exporter turns positions, normals and nodes; attributes it leaves alone, so spherical harmonics
are turned here.
"""

from collections.abc import Iterable, Iterator, Mapping
from typing import Any

import numpy as np
import numpy.typing as npt

from .prt import sh
from .prt.layout import Layout, Values, pack, unpack

Float = npt.NDArray[np.float64]

Y_UP: Float = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]])
Z_UP: Float = np.eye(3)  # an export with +Y Up switched off


def of(settings: Mapping[str, Any]) -> Float:
    """The frame of an export with these ``settings`` of the exporter."""
    return Y_UP if settings["gltf_yup"] else Z_UP


def turned(
    values: npt.NDArray[np.float32], layout: Layout, shown: Layout, share: float, frame: Float
) -> npt.NDArray[np.float32]:
    """Attribute values (E, 4 k) of ``layout`` as those of ``shown``, which may have less, with the
    transfer and what is seen turned to ``frame`` and a ``share`` of the residuals, which have no
    direction; nor have the visibilities of lights.  What is not finite becomes 0: glTF allows no
    NaN."""
    stored = unpack(layout, np.nan_to_num(values, posinf=0, neginf=0))
    transfer = stored.transfer @ sh.rotation_matrix(frame, layout.order).T
    seen = stored.visibility_sh
    if layout.visibility_order:
        seen = seen @ sh.rotation_matrix(frame, layout.visibility_order).T
    return pack(
        shown,
        Values(
            transfer.astype(np.float32),
            np.float32(share) * stored.residual[:, : shown.turns],
            stored.visibility[:, : shown.lights],
            seen[:, : shown.visibility_order**2].astype(np.float32),
        ),
    )


def turn_matrix(matrix: npt.ArrayLike, frame: Float) -> Float:
    """A world 3x3 (9 numbers, column-major) of Blender as one (3, 3) that takes turned positions to
    turned positions."""
    blender = np.reshape(np.asarray(matrix, np.float64), (3, 3), order="F")
    return np.asarray(frame @ blender @ frame.T)


def world_matrices(nodes: Iterable[Any]) -> dict[int, Float]:
    """The world 3x3 of every node of the exporter under the roots ``nodes``, by ``id(node)``, as a
    reader of the file will multiply it."""
    return dict(_worlds(nodes, np.eye(3)))


def _worlds(nodes: Iterable[Any], parent: Float) -> Iterator[tuple[int, Float]]:
    for node in nodes:
        world = parent @ _local(node)
        yield id(node), world
        yield from _worlds(node.children or (), world)


def _local(node: Any) -> Float:
    """Rotation times scale of one node; the exporter writes no matrices."""
    x, y, z, w = node.rotation or (0, 0, 0, 1)
    rotation = np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
            [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
            [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
        ]
    )
    return np.asarray(rotation * np.asarray(node.scale or (1, 1, 1), np.float64))
