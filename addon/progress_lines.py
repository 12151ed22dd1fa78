"""Progress on a terminal or in a log."""

from time import monotonic
from typing import TextIO

from . import figures
from .prt.job import Progress

PAUSE = 5.0  # seconds between lines in a log


class ProgressLines:
    """One line that is written over on a terminal; elsewhere a line now and then."""

    def __init__(self, stream: TextIO) -> None:
        self._stream = stream
        self._terminal = stream.isatty()
        self._next = 0.0
        self._phase = ""

    def show(self, progress: Progress) -> None:
        """Say where the job is, unless it was said a moment ago."""
        if progress.fraction < 0:
            return
        line = figures.progress_line(progress)
        if self._terminal:
            self._stream.write(f"\r\033[K{line}")
        elif progress.phase != self._phase or monotonic() >= self._next:
            self._next = monotonic() + PAUSE
            self._phase = progress.phase
            self._stream.write(f"{line}\n")
        self._stream.flush()

    def close(self) -> None:
        """Leave the terminal's line free for what comes next."""
        if self._terminal:
            self._stream.write("\r\033[K")
            self._stream.flush()
