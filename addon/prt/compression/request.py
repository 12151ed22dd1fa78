"""Parts to be coded, as a folder of arrays that the engine's process reads and answers in.

compress.json           what is written last: tolerance, seed, and of each part step, clustered
0_values.npy ...        the arrays of part 0, see ``choosing.Part``
results/                0_clusters.npy ... as in ``pca.Codes``, and report.json
"""

import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from .choosing import Part, chosen
from .pca import Codes

REQUEST, RESULTS = "compress.json", "results"
ARRAYS = "values", "importance", "radiance"
CODES = "clusters", "weights", "means", "directions"
Coded = tuple[Codes | None, dict[str, Any]]


@dataclass(frozen=True)
class Request:
    """What is to be coded, within which relative error of the light."""

    parts: Sequence[Part]
    tolerance: float
    seed: int = 0


def write(request: Request, folder: Path) -> None:
    """Write ``request`` into an existing, empty ``folder``."""
    for i, part in enumerate(request.parts):
        for name in ARRAYS:
            np.save(folder / f"{i}_{name}.npy", getattr(part, name))
    values = {
        "tolerance": request.tolerance,
        "seed": request.seed,
        "parts": len(request.parts),
    }
    unfinished = folder / f"{REQUEST}.tmp"
    unfinished.write_text(json.dumps(values), encoding="utf-8")
    unfinished.rename(folder / REQUEST)


def is_written(folder: Path) -> bool:
    """Whether all of a request is in ``folder``."""
    return (folder / REQUEST).exists()


def answer(folder: Path) -> None:
    """Do what the request in ``folder`` asks for, and write the results."""
    values = json.loads((folder / REQUEST).read_text(encoding="utf-8"))
    unfinished = folder / f"{RESULTS}.tmp"
    unfinished.mkdir()
    reports = []
    for i in range(values["parts"]):
        arrays = [np.load(folder / f"{i}_{name}.npy") for name in ARRAYS]
        codes, report = chosen(Part(*arrays), values["tolerance"], values["seed"])
        reports.append(report)
        for name in CODES if codes is not None else ():
            np.save(unfinished / f"{i}_{name}.npy", getattr(codes, name))
    (unfinished / "report.json").write_text(json.dumps(reports), encoding="utf-8")
    unfinished.rename(folder / RESULTS)


def read_answer(folder: Path) -> list[Coded]:
    """The codes of every part, None where it is better left as it is, and their reports."""
    done = folder / RESULTS
    reports = json.loads((done / "report.json").read_text(encoding="utf-8"))
    found: list[Coded] = []
    for i, report in enumerate(reports):
        arrays = [done / f"{i}_{name}.npy" for name in CODES]
        codes = Codes(*map(np.load, arrays)) if report["chosen"] else None
        found.append((codes, report))
    return found
