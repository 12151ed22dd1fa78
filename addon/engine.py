"""The engine in a process of its own: started, watched, and killed when nobody waits any more.

Needs no Blender.  The child reads and writes one job folder, which is deleted in the end whatever
happens.
"""

import errno
import json
import os
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Callable, Generator, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from .prt import job as jobs
from .prt import packages
from .prt.compression.request import Coded, Request, read_answer
from .prt.compression.request import write as write_request
from .prt.errors import BakeError, no_room
from .prt.results import Results, read_results
from .prt.steps import value_of

# Our folders come last in the child's path: a sibling named like a part of the standard library
# would kill it.  Modules are garbage to nobody: until all are there, to look for some would take a
# fifth of the time.
BOOT = (
    "import gc, runpy, sys; gc.disable(); sys.path.extend(sys.argv[2:]); del sys.argv[2:]; "
    "runpy.run_module('prt', run_name='__main__', alter_sys=True)"
)
NATIVE_PACKAGES = ("embreex", "OpenEXR")
FOR_TEXTURES = ("xatlas",)  # a bake to vertices does without
ONE_BLAS_THREAD = dict.fromkeys(
    (
        "OPENBLAS_NUM_THREADS",
        "OMP_NUM_THREADS",
        "MKL_NUM_THREADS",
        "VECLIB_MAXIMUM_THREADS",
        "BLIS_NUM_THREADS",
    ),
    "1",
)
POLL_SECONDS = 0.05
FULL = (None, errno.ENOSPC, errno.EDQUOT, errno.EFBIG)  # numpy gives a short write no number


@contextmanager
def job_folder() -> Iterator[Path]:
    """A new empty folder, gone afterwards; BakeError when its disk is full."""
    try:
        folder = Path(tempfile.mkdtemp(prefix="prt-job-"))
    except OSError as error:
        raise BakeError(
            f"No temporary folder can be made ({error.strerror}): make room, or set TMPDIR to "
            "another folder"
        ) from error
    try:
        yield folder
    except OSError as error:
        if error.errno in FULL:
            raise no_room(folder.parent, error) from error
        raise
    finally:
        shutil.rmtree(folder, ignore_errors=True)


def run(job: jobs.Job, folder: Path) -> Generator[jobs.Progress, None, Results]:
    """Do ``job`` in an existing, empty ``folder``; its results are the generator's value.

    ``close()`` kills the child at once.  BakeError where the engine says what can be mended,
    RuntimeError with its traceback where the fault is ours.  The child starts while the job is
    still written, and waits for the end of its standard input.
    """
    yield from _answered(folder, lambda: jobs.write(job, folder))
    return read_results(folder)


def run_light(source: jobs.LightSource, folder: Path) -> Results:
    """What the engine makes of ``source`` in an existing, empty ``folder``: the coefficients of its
    image, unrotated; waits for the child."""
    return value_of(run(jobs.Job("light", jobs.Settings(), source), folder))


def compressed(request: Request) -> list[Coded]:
    """The answer to ``request``; waits for the child, and fails as ``run`` does."""
    with job_folder() as folder:
        for _ in _answered(folder, lambda: write_request(request, folder)):
            pass
        return read_answer(folder)


def _answered(folder: Path, write: Callable[[], None]) -> Iterator[jobs.Progress]:
    """Yield the progress of a child in ``folder`` that does what ``write`` puts there."""
    process = _start(folder)
    try:
        write()
        _close_pipe(process)
        yield from _watch(process, folder)
    finally:
        _close_pipe(process)
        process.kill()
        process.wait()


def _start(folder: Path) -> subprocess.Popen[bytes]:
    # Its modules' bytecode lies where Blender, which imports some of them, puts it too
    flags = ["-I", "-B"] if sys.dont_write_bytecode else ["-I"]
    command = [sys.executable, *flags, "-c", BOOT, str(folder), *_child_path()]
    with (folder / "stderr.txt").open("wb") as errors:
        return subprocess.Popen(
            command,
            stdin=subprocess.PIPE,
            stdout=subprocess.DEVNULL,
            stderr=errors,
            env={**os.environ, **ONE_BLAS_THREAD},
            creationflags=getattr(subprocess, "CREATE_NO_WINDOW", 0),
        )


def _close_pipe(process: subprocess.Popen[bytes]) -> None:
    """Nothing was written to it, so nothing can be lost where the child has gone already."""
    assert process.stdin is not None
    process.stdin.close()


def _child_path() -> list[str]:
    """This folder, and those of the native packages, found without importing them."""
    folders = [str(Path(__file__).parent)]
    for package in (*NATIVE_PACKAGES, *FOR_TEXTURES):
        folder = packages.home(package)
        if folder is not None:
            folders.append(str(folder))
        elif package not in FOR_TEXTURES:
            raise BakeError(f"The package {package} is missing: install the extension again")
    return list(dict.fromkeys(folders))


def _watch(process: subprocess.Popen[bytes], folder: Path) -> Iterator[jobs.Progress]:
    """Yield the child's latest progress until it has ended well; raise what it says otherwise."""
    position, latest = 0, jobs.Progress("start", 0.0)
    while True:
        code = _wait(process)
        lines, position = _new_lines(folder / "progress.jsonl", position)
        for line in lines:
            if "error" in line:
                raise BakeError(line["error"])
            if "fault" in line:
                raise RuntimeError(f"The engine failed\n{line['fault']}")
            latest = jobs.Progress(**line)
        if code:
            raise _ended(code, folder)
        yield latest
        if code == 0:
            return


def _ended(code: int, folder: Path) -> Exception:
    """What to raise for a child that ended without a word."""
    if code == 2:
        return no_room(folder.parent, OSError())
    if code == -9:
        return BakeError(
            "The system stopped the bake, most likely for want of memory: "
            "hide what casts no shadow on the baked objects"
        )
    errors = (folder / "stderr.txt").read_text(encoding="utf-8", errors="replace")
    return RuntimeError(f"The engine stopped with code {code}\n{errors}")


def _wait(process: subprocess.Popen[bytes]) -> int | None:
    try:
        return process.wait(POLL_SECONDS)
    except subprocess.TimeoutExpired:
        return None


def _new_lines(path: Path, position: int) -> tuple[list[dict[str, Any]], int]:
    """The whole lines after ``position``, and where they end."""
    if not path.exists():
        return [], position
    with path.open("rb") as file:
        file.seek(position)
        text = file.read()
    end = text.rfind(b"\n") + 1
    return [json.loads(line) for line in text[:end].splitlines()], position + end
