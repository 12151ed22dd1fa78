"""Run the tests of numerical stability and write docs/stability.md: a row for each of them.

A test's docstring is its row, "case: what is asserted"; the largest of the values that it records
as ``measured``, over all its parameters, stands beside it.
"""

import ast
import sys
from collections import defaultdict
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
PAGE = ROOT / "docs" / "stability.md"
FOLDERS = ("engine", "blender")
HEAD = "| case | asserted | measured | test |\n|---|---|---|---|\n"

TEMPLATE = """# Numerical stability

Written by `python benchmarks/stability.py`, from the tests that assert it. Every test stands here,
and none else. *Measured* is the largest error or difference that the test's cases gave, in the
units of what is asserted; *holds* is a behaviour without a number.

Rays start 2⁻¹⁹ of the largest nearby coordinate off a surface, coordinates being centred on what is
baked. So what is thinner or nearer than two millionths of the distance from the middle of the baked
objects is not told apart, whatever the unit: objects that lie kilometres from each other are better
baked one by one. A job takes sizes from 1e-10 to 1e12.

{tables}
"""


class Recorder:
    """A plugin of pytest that keeps what tests measured, and which of them are known to fail."""

    def __init__(self) -> None:
        self.measured: dict[str, list[float]] = defaultdict(list)
        self.known: dict[str, str] = {}
        self.seconds = 0.0

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        """Called by pytest after each phase of each test."""
        self.seconds += report.duration
        if report.when != "call":
            return
        name = report.location[2].partition("[")[0]
        values = [float(value) for key, value in report.user_properties if key == "measured"]
        if hasattr(report, "wasxfail"):
            self.known[name] = report.wasxfail.removeprefix("reason: ")
        else:
            self.measured[name] += values

    def cell(self, name: str) -> str:
        """What the page says of the test ``name``."""
        values = self.measured.get(name)
        found = "holds" if not values else f"{max(values):.1e}" if max(values) else "0"
        if name not in self.known:
            return found
        known = f"**fails**: {self.known[name]}"
        return f"{found}; {known}" if values else known


def modules() -> list[Path]:
    """The files of tests that the page is about."""
    return [
        p for folder in FOLDERS for p in sorted((ROOT / "tests" / folder).glob("test_stress_*"))
    ]


def rows(module: Path) -> Iterator[tuple[str, str, str]]:
    """Name, case and assertion of each test of ``module``."""
    for node in ast.parse(module.read_text("utf-8")).body:
        if isinstance(node, ast.FunctionDef) and node.name.startswith("test_"):
            text = " ".join((ast.get_docstring(node) or "").split())
            case, _, asserted = text.partition(": ")
            yield node.name, case, asserted.rstrip(".")


def page(recorder: Recorder) -> str:
    """The page's text."""
    tables = []
    for module in modules():
        title = (ast.get_docstring(ast.parse(module.read_text("utf-8"))) or "").partition("\n")[0]
        lines = [
            f"| {case} | {asserted} | {recorder.cell(name)} | `{name}` |"
            for name, case, asserted in rows(module)
        ]
        place = module.relative_to(ROOT).as_posix()
        tables.append(f"## {title.rstrip('.')}\n\n`{place}`\n\n{HEAD}" + "\n".join(lines))
    return TEMPLATE.format(tables="\n\n".join(tables))


def main() -> int:
    """Run the tests and write the page; pytest's exit code."""
    recorder = Recorder()
    files = [str(module) for module in modules()]
    code = pytest.main(["-q", "-p", "no:cacheprovider", *files], plugins=[recorder])
    if code == pytest.ExitCode.OK:
        PAGE.write_text(page(recorder), encoding="utf-8")
        print(f"{PAGE.relative_to(ROOT)}: {recorder.seconds:.0f} s of tests")
    return int(code)


if __name__ == "__main__":
    sys.exit(main())
