"""Cells that lie together and face one way: light that arrives at one place in such a patch stands
for what arrives at all of it.  So a finely cut floor takes no more places than a coarse one."""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from ..mixing import mixed

Index = npt.NDArray[np.int64]
Keys = npt.NDArray[np.uint64]
Float = npt.NDArray[np.float64]

FACINGS = 2  # steps of a normal's coordinates from 0 to 1
LAYERS = 4  # of a patch's side: what lies that far behind another is a patch of its own


@dataclass(frozen=True)
class Patches:
    """The ``keys`` (G,) of patches, in rising order, the patch of each cell, ``of_cells`` (E,), and
    the cells in the middle of each patch and farthest from there, ``middle`` and ``rim`` (G,)."""

    keys: Keys
    of_cells: Index
    middle: Index
    rim: Index


def keys_of(centres: Float, normals: Float, side: float) -> Keys:
    """Names of the patches (E,), about ``side`` wide, of cells whose ``centres`` (E, 3) and unit
    ``normals`` (E, 3) these are."""
    behind = np.einsum("ec,ec->e", centres, normals) * LAYERS
    where = np.floor(np.column_stack([centres, behind]) / side)
    cells = np.column_stack([where, np.rint(FACINGS * normals)]).astype(np.int64)
    return mixed(cells.T.view(np.uint64))


def patches(centres: Float, keys: Keys) -> Patches:
    """The patches of cells with these ``centres`` (E, 3) and ``keys`` (E,)."""
    names, of_cells = np.unique(keys, return_inverse=True)
    sizes = np.bincount(of_cells)
    means = np.stack([np.bincount(of_cells, c) / sizes for c in centres.T], axis=1)
    away = np.square(centres - means[of_cells]).sum(axis=1)
    order, ends = np.lexsort([away, of_cells]), np.cumsum(sizes)
    return Patches(names, of_cells, order[ends - sizes], order[ends - 1])
