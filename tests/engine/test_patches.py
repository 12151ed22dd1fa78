"""Cells that share a place."""

import numpy as np
import pytest
from prt_baker.addon.prt.bounces.patches import keys_of, patches

UP = np.array([0.0, 0.0, 1.0])


def sheet(count, height=0.0, normal=UP):
    """The middles and normals of ``count`` x ``count`` cells of a sheet of side 1."""
    middle = (np.arange(count) + 0.5) / count
    x, y = np.meshgrid(middle, middle)
    centres = np.stack([x, y, np.full_like(x, height)], axis=-1).reshape(-1, 3)
    return centres, np.tile(normal, (len(centres), 1))


@pytest.mark.parametrize("count", [40, 160])
def test_a_sheet_has_as_many_however_finely_it_is_cut(count):
    centres, normals = sheet(count, 0.05)
    found = patches(centres, keys_of(centres, normals, 0.1))
    assert len(found.middle) == len(found.rim) == 100
    np.testing.assert_array_equal(found.of_cells[found.middle], np.arange(100))
    np.testing.assert_array_equal(found.of_cells[found.rim], np.arange(100))
    np.testing.assert_array_equal(found.keys[found.of_cells], keys_of(centres, normals, 0.1))
    away = np.linalg.norm(centres - centres[found.middle][found.of_cells], axis=1)
    assert away.max() <= 0.1


def test_a_coarse_one_has_a_place_for_every_cell():
    centres, normals = sheet(6)
    assert len(patches(centres, keys_of(centres, normals, 0.1)).middle) == 36


def test_sheets_that_face_another_way_or_lie_behind_are_apart():
    under, above, below = sheet(40, 0.01), sheet(40, 0.06), sheet(40, 0.01, -UP)
    centres, normals = (np.concatenate(pair) for pair in zip(under, above, below, strict=True))
    found = patches(centres, keys_of(centres, normals, 0.1))
    for k in range(3):
        its = found.of_cells[1600 * k : 1600 * (k + 1)]
        others = np.delete(found.of_cells, slice(1600 * k, 1600 * (k + 1)))
        assert not np.isin(its, others).any()
