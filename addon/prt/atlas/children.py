"""Child processes that do tasks side by side; killed when nobody waits any more.

xatlas holds Python's lock and can't be interrupted, so threads would neither run at once nor end.
A child starts as the engine itself does, and speaks through its pipes, so that nothing is left on
disk whatever happens.
"""

import importlib.util
import os
import queue
import subprocess
import sys
import threading
from collections.abc import Generator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ThreadPoolExecutor, wait
from pathlib import Path
from typing import BinaryIO, cast

from ..errors import BakeError
from .messages import Arrays, receive, send

BOOT = (
    "import runpy, sys; sys.path.extend(sys.argv[1:]); del sys.argv[1:]; "
    "runpy.run_module('prt.atlas.worker', run_name='__main__', alter_sys=True)"
)
PACKAGE = "xatlas"
TICK = 0.25  # seconds between two signs of life
PATIENCE = 5.0  # seconds for a child to be ready again, which takes it some milliseconds

Process = subprocess.Popen[bytes]


class ChildLostError(Exception):
    """A child ended in the middle of task ``number``; ``reason`` is what it left."""

    def __init__(self, number: int, reason: str) -> None:
        super().__init__(f"A child that unwraps ended\n{reason}")
        self.number, self.reason = number, reason


class Children:
    """Up to ``count`` processes, 0 for one a core, started when there is work; ``close`` kills
    them."""

    def __init__(self, count: int) -> None:
        self._count = count or os.cpu_count() or 1
        self._threads = ThreadPoolExecutor(self._count)
        self._idle: queue.LifoQueue[Process] = queue.LifoQueue()
        self._all: list[Process] = []

    def answers(self, tasks: Sequence[Arrays]) -> Generator[int, None, list[Arrays]]:
        """The answers to ``tasks``; yields how many are there, every ``TICK`` at the latest.
        ChildLostError where a child has died of one."""
        while len(self._all) < min(self._count, len(tasks)):
            self._idle.put(self._started())
        waiting = [self._threads.submit(self._do, k, task) for k, task in enumerate(tasks)]
        left: set[Future[Arrays]] = set(waiting)
        while left:
            done, left = wait(left, TICK, FIRST_COMPLETED)
            for future in done:
                future.result()
            yield len(waiting) - len(left)
        return [future.result() for future in waiting]

    def close(self) -> None:
        """Kill them, in the middle of whatever they do."""
        self._threads.shutdown(wait=False, cancel_futures=True)
        for process in self._all:
            process.kill()
        self._threads.shutdown()
        for process in self._all:
            process.communicate()
        self._all.clear()

    def _started(self) -> Process:
        self._all.append(self._start())
        return self._all[-1]

    def _start(self) -> Process:
        flags = ["-I", "-B"] if sys.dont_write_bytecode else ["-I"]
        return subprocess.Popen(
            [sys.executable, *flags, "-c", BOOT, *_child_path()],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            creationflags=getattr(subprocess, "CREATE_NO_WINDOW", 0),
        )

    def _do(self, number: int, task: Arrays) -> Arrays:
        process = self._idle.get()
        if process.poll() is not None:
            process = self._started()
        assert process.stderr is not None
        try:
            send(cast(BinaryIO, process.stdin), task)
            answer = receive(cast(BinaryIO, process.stdout))
        except OSError:
            answer = None
        if answer is None:
            raise ChildLostError(number, process.stderr.read().decode(errors="replace"))
        _wait_until_ready(process)
        self._idle.put(process)
        return answer


def _wait_until_ready(process: Process) -> None:
    """Until a child that has answered can take another task; it is killed where it can't, as
    xatlas may hang while it cleans up."""
    timer = threading.Timer(PATIENCE, process.kill)
    timer.start()
    try:
        if receive(cast(BinaryIO, process.stdout)) is None:
            process.wait()
    finally:
        timer.cancel()


def _child_path() -> list[str]:
    """The folder of the engine and that of xatlas, found without importing it."""
    spec = importlib.util.find_spec(PACKAGE)
    if spec is None or spec.origin is None:
        raise BakeError(f"The package {PACKAGE} is missing: install the extension again")
    origin = Path(spec.origin)
    home = origin.parent.parent if origin.stem == "__init__" else origin.parent
    return [str(Path(__file__).parents[2]), str(home)]
