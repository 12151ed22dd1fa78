"""The engine as a program: ``python -m prt JOB_FOLDER``, a job or a request to compress bakes.

Where the job is not there yet, the end of the standard input says that it is.
Writes ``progress.jsonl`` and, when all is done, ``results``.  Exit codes: 0 done, 2 a BakeError,
1 a fault of ours; both leave their text as the last line of the progress file, if there is room.
"""

import gc
import json
import os
import sys
import time
import traceback
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any, TextIO

from . import job as jobs
from .errors import BakeError, no_room
from .parallel import in_thread
from .results import Results, write_results
from .run import run

PROGRESS = "progress.jsonl"
INTERVAL = 0.05  # seconds between two lines


def main(folder: Path) -> int:
    """Do the job in ``folder``; the exit code."""
    gc.freeze()  # the modules
    gc.enable()
    try:
        with (folder / PROGRESS).open("a", encoding="utf-8") as progress:
            return _guarded(folder, progress)
    except OSError:  # no room even for the reason
        return 2


def _guarded(folder: Path, progress: TextIO) -> int:
    try:
        _run(folder, progress)
    except BakeError as error:
        return _say(progress, 2, error=str(error))
    except MemoryError:
        sentence = "There is not enough memory for this bake: hide what casts no shadow on it"
        return _say(progress, 2, error=sentence)
    except OSError as error:
        return _say(progress, 2, error=str(no_room(folder.parent, error)))
    except Exception:  # noqa: BLE001 - the parent shows its traceback
        return _say(progress, 1, fault=traceback.format_exc())
    return 0


def _run(folder: Path, progress: TextIO) -> None:
    if not jobs.is_written(folder):
        sys.stdin.read()
    if not jobs.is_written(folder):
        from .compression import request  # which a bake need not wait for

        if request.is_written(folder):
            request.answer(folder)
            return
    steps = run(jobs.read(folder))
    last, phase, step = 0.0, "", jobs.Progress("start", 0.0)
    while True:
        try:
            step = next(steps)
        except StopIteration as stop:
            _keep(stop.value, folder, progress, step)
            return
        if step.phase != phase or time.monotonic() - last > INTERVAL:
            last, phase = time.monotonic(), step.phase
            _write(progress, asdict(step))


def _keep(results: Results, folder: Path, progress: TextIO, step: jobs.Progress) -> None:
    """Write ``results``, which takes seconds where textures are large, with signs of life: the last
    ``step``, later and later."""
    start = time.monotonic()
    for _ in in_thread(lambda: write_results(results, folder)):
        seconds = step.seconds + time.monotonic() - start
        _write(progress, asdict(replace(step, seconds=seconds)))


def _say(progress: TextIO, code: int, **line: str) -> int:
    _write(progress, line)
    return code


def _write(progress: TextIO, line: dict[str, Any]) -> None:
    progress.write(json.dumps(line) + "\n")
    progress.flush()


if __name__ == "__main__":
    code = main(Path(sys.argv[1]))
    sys.stderr.flush()
    os._exit(code)  # all is written; taking Embree's structure apart would only take time
