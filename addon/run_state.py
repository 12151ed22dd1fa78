"""What runs right now, for panel and status bar.  In memory only, never in a .blend."""

from dataclasses import dataclass, field

from .prt.errors import BakeError
from .prt.job import Progress


@dataclass(eq=False)
class Run:
    """A job under way: ``label`` names its operator; ``stop`` asks it to end at its next tick."""

    label: str
    progress: Progress = field(default_factory=lambda: Progress("scene", 0.0))
    stop: bool = False


_runs: list[Run] = []  # one at most


def current() -> Run | None:
    """The job that runs, or None."""
    return _runs[0] if _runs else None


def obstacle() -> str | None:
    """Why no job can start now; None when one can."""
    run = current()
    return f"{run.label} is running: wait for it, or press Esc to cancel it" if run else None


def begin(label: str) -> Run:
    """Announce a job; BakeError while another one runs."""
    reason = obstacle()
    if reason:
        raise BakeError(reason)
    _runs.append(Run(label))
    return _runs[0]


def end(run: Run) -> None:
    """Forget ``run``."""
    if run in _runs:
        _runs.remove(run)
