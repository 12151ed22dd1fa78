"""Numbers in an artist's words, the same in panel, status bar and command line."""

from .prt.job import Progress
from .stamp import Stamp

PHASES = {
    "scene": "Reading the scene",
    "start": "Starting the engine",
    "light": "Reading the light",
    "prepare": "Preparing the scene",
    "transfer": "Tracing",
    "verify": "Tracing again to verify",
}


def phase(progress: Progress) -> str:
    """What is being done."""
    return PHASES.get(progress.phase, progress.phase)


def percent(error: float) -> str:
    """A relative error as '12 %', '1.2 %' or 'under 0.1 %'."""
    value = 100 * error
    if value < 0.095:
        return "under 0.1 %"
    return f"{value:.1f} %" if value < 9.95 else f"{value:.0f} %"


def duration(seconds: float) -> str:
    """Seconds as '8 s', '2 min 05 s' or '1 h 04 min'."""
    whole = max(0, round(seconds))
    if whole < 60:
        return f"{whole} s"
    if whole < 3600:
        return f"{whole // 60} min {whole % 60:02d} s"
    return f"{whole // 3600} h {whole % 3600 // 60:02d} min"


def objects(count: int) -> str:
    """'1 object' or '3 objects'."""
    return f"{count} object" if count == 1 else f"{count} objects"


def progress_line(progress: Progress) -> str:
    """Phase, per cent and time left, as one line."""
    left = progress.seconds_left
    tail = f", {duration(left)} left" if left is not None else ""
    return f"{phase(progress)}, {100 * progress.fraction:.0f} %{tail}"


def stamp_lines(stamp: Stamp) -> list[str]:
    """What a bake says of itself: size, speed, and its errors where they are known."""
    return [
        f"order {stamp.order}, {stamp.points:,} points",
        f"{stamp.rays:,} rays a point, {stamp.mrays_per_second:.1f} Mrays/s",
        *_errors([stamp]),
    ]


def summary_lines(stamps: list[Stamp]) -> list[str]:
    """Several bakes together: how many, how large, how fast, and the worst of their errors."""
    points = sum(stamp.points for stamp in stamps)
    mrays = sum(stamp.points * stamp.rays for stamp in stamps) / 1e6
    seconds = sum(
        stamp.points * stamp.rays / 1e6 / max(stamp.mrays_per_second, 1e-9) for stamp in stamps
    )
    speed = f"{mrays:,.1f} Mrays, {mrays / max(seconds, 1e-9):.1f} Mrays/s"
    return [f"{objects(len(stamps))}, {points:,} points", speed, *_errors(stamps)]


def advice(stamp: Stamp) -> str | None:
    """What would make a bake better, when it was verified and more rays would not."""
    noise, error = stamp.estimated_error, stamp.measured_error
    if noise is None or error is None or error < max(0.05, 3 * noise):
        return None
    return "Most of this error lies between the vertices: subdivide the mesh where shadows fall"


def _errors(stamps: list[Stamp]) -> list[str]:
    estimated = [one.estimated_error for one in stamps if one.estimated_error is not None]
    measured = [one.measured_error for one in stamps if one.measured_error is not None]
    lines = [f"{percent(max(estimated))} noise, estimated"] if estimated else []
    return lines + ([f"{percent(max(measured))} error measured"] if measured else [])
