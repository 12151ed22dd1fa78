import numpy as np
import pytest
from prt_baker.addon.prt.arrays import read_all, write_all


@pytest.mark.parametrize("mapped", [False, True])
@pytest.mark.parametrize(
    "shapes",
    [
        [],
        [(0, 3)],
        [(2, 3)],
        [(0, 3), (5, 3), (0, 0, 3), (1, 1, 9), (4, 3)],
        [(0,), (7,), (0,)],
        [(1, 3)] * 100,
    ],
)
def test_what_is_written_comes_back(tmp_path, shapes, mapped):
    random = np.random.default_rng(0)
    arrays = [random.random(shape, np.float32) for shape in shapes]
    kept = write_all(tmp_path / "a.npy", arrays)
    found = read_all(tmp_path / "a.npy", kept, mapped)
    assert len(found) == len(arrays)
    for one, other in zip(found, arrays, strict=True):
        np.testing.assert_array_equal(one, other)
        assert (one.shape, one.dtype) == (other.shape, other.dtype)


def test_the_file_is_numpys_own_and_strides_do_not_matter(tmp_path):
    whole = np.arange(24, dtype=np.int32).reshape(4, 6)
    write_all(tmp_path / "a.npy", [whole[::2], whole.T])
    expected = np.concatenate([whole[::2].ravel(), whole.T.ravel()])
    np.testing.assert_array_equal(np.load(tmp_path / "a.npy"), expected)


def test_what_is_mapped_cannot_be_changed(tmp_path):
    kept = write_all(tmp_path / "a.npy", [np.zeros((3, 3), np.float32)])
    with pytest.raises(ValueError, match="read-only"):
        read_all(tmp_path / "a.npy", kept, mapped=True)[0][0] = 1
