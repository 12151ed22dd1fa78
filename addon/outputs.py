"""Files that are written whole or not at all.

Every one is written beside its place under another name; only when all of them are there do they
take their names.
"""

import os
import secrets
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from .prt.errors import BakeError


def check(paths: list[Path]) -> None:
    """Refuse, with BakeError, what cannot be written, before any work is done for it."""
    for path in paths:
        if path.is_dir():
            raise BakeError(f"{path} is a folder: give the name of a file")
        if not path.parent.is_dir():
            raise BakeError(f"The folder {path.parent} does not exist: make it first")
        trial = _beside(path)
        try:
            trial.write_bytes(b"")
        except OSError as error:
            raise _cannot_write(path, error) from error
        trial.unlink()


@contextmanager
def staged(paths: list[Path]) -> Iterator[dict[Path, Path]]:
    """For each of ``paths`` the name to write to; on success they take their places together,
    on failure nothing stays.  An OSError becomes a BakeError; one that names a passing name is
    told with the real one."""
    places = {path: _beside(path) for path in paths}
    try:
        yield places
        for path, place in places.items():
            place.replace(path)
    except OSError as error:
        raise _cannot_write(" and ".join(map(str, paths)), error) from error
    except BakeError as error:
        sentence = str(error)
        for path, place in places.items():
            sentence = sentence.replace(str(place), str(path))
        raise BakeError(sentence) from error
    finally:
        for place in places.values():
            place.unlink(missing_ok=True)


def _beside(path: Path) -> Path:
    """A new name in the same folder, with the same ending."""
    return path.absolute().with_name(f".prt-{os.getpid()}-{secrets.token_hex(4)}{path.suffix}")


def _cannot_write(path: object, error: OSError) -> BakeError:
    return BakeError(f"{path} cannot be written: {error.strerror or error}")
