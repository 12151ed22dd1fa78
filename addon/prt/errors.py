"""The one kind of failure that an artist can mend."""

from pathlib import Path


class BakeError(Exception):
    """One sentence that says what is wrong and what to do; shown as it is, without a traceback."""


def no_room(folder: Path, error: OSError) -> BakeError:
    """What to say when ``folder`` takes no more; numpy gives a short write without its reason."""
    reason = error.strerror or "No space left on device"
    return BakeError(
        f"The temporary folder {folder} cannot be written ({reason}): "
        "make room there, or set TMPDIR to another folder"
    )
