"""A child process that unwraps and packs: ``python -m prt.atlas.worker``.

Reads tasks from its standard input until that ends and answers each on its standard output.  What
xatlas prints goes nowhere.
"""

import ctypes
import os
import signal
import sys
from typing import BinaryIO

import numpy as np

from . import charting
from .messages import Arrays, receive, send

PR_SET_PDEATHSIG = 1
READY: Arrays = {}  # follows an answer, when another task may come


def main() -> None:
    """Answer tasks until there are no more."""
    _die_with_parent()
    source, answers = sys.stdin.buffer, os.fdopen(os.dup(1), "wb")
    nowhere = os.open(os.devnull, os.O_WRONLY)
    os.dup2(nowhere, 1)
    try:
        _answer(source, answers)
    except BrokenPipeError:  # nobody waits any more
        os._exit(0)


def _answer(source: BinaryIO, answers: BinaryIO) -> None:
    while (task := receive(source)) is not None:
        send(answers, _pack(task) if "density" in task else _unwrap(task))
        charting.delete_atlases()
        send(answers, READY)


def _unwrap(task: Arrays) -> Arrays:
    found = charting.unwrapped(task["vertices"], task["triangles"], task["loops"], task["pieces"])
    return {"uvs": found.uvs, "triangles": found.triangles, "charts": found.charts}


def _pack(task: Arrays) -> Arrays:
    """The places of the charts; of length 0 where they don't fit."""
    size, padding = (int(task[name][0]) for name in ("size", "padding"))
    density = float(task["density"][0])
    charts = charting.Charts(task["uvs"], task["triangles"], task["charts"].astype(np.int64))
    places = charting.packed(charts, size, density, padding)
    return {"places": np.empty((0, 3, 2), np.float32) if places is None else places}


def _die_with_parent() -> None:
    """End at once when the parent is killed: xatlas lets nothing else run while it works.
    Elsewhere than on Linux a child notices when it has done its task."""
    if sys.platform == "linux":
        parent = os.getppid()
        ctypes.CDLL(None).prctl(PR_SET_PDEATHSIG, signal.SIGKILL)
        if os.getppid() != parent:
            os._exit(0)


if __name__ == "__main__":
    main()
