"""docs/stability.md and the tests of stability say the same."""

import re

import pytest

ROW = re.compile(
    r"^\| (?P<case>.+?) \| (?P<asserted>.+?) \| (?P<measured>.+?) \| `(?P<name>\w+)` \|$"
)


@pytest.fixture(scope="module")
def stability(root):
    """benchmarks/stability.py, which is no part of the package."""
    namespace = {"__name__": "stability", "__file__": str(root / "benchmarks" / "stability.py")}
    exec((root / "benchmarks" / "stability.py").read_text("utf-8"), namespace)
    return namespace


@pytest.fixture(scope="module")
def written(root):
    text = (root / "docs" / "stability.md").read_text("utf-8")
    lines = [line for line in text.splitlines() if line.startswith("| ")]
    return [ROW.match(line) for line in lines if not line.endswith("| test |")]


def test_every_row_names_a_test_and_every_test_has_its_row(stability, written):
    assert all(written)
    tests = [row for module in stability["modules"]() for row in stability["rows"](module)]
    assert len(tests) > 40
    assert [row.group("name", "case", "asserted") for row in written] == tests


def test_every_test_says_case_and_assertion(stability):
    for module in stability["modules"]():
        for name, case, asserted in stability["rows"](module):
            assert case, name
            assert asserted, name


def test_a_number_stands_where_one_was_measured(stability):
    recorder = stability["Recorder"]()
    recorder.measured["a"] += [1e-7, 2.5e-3]
    recorder.measured["b"] += [0.0]
    recorder.known["c"] = "because"
    assert [recorder.cell(name) for name in "abcd"] == [
        "2.5e-03",
        "0",
        "**fails**: because",
        "holds",
    ]
