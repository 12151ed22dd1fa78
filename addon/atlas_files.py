"""Where atlases lie on disk, and their way there: whole or not at all.

A file of ours says so in its header, with the hash of its bake.  Files of the artist's are never
written over, nor those that other baked objects show.
"""

import re
import secrets
import shutil
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import bpy

from . import outputs, stamp
from .prt.errors import BakeError

MARK = b"prtBaker"
HEADER = 1 << 16  # bytes, in which the mark is
SUFFIX = ".exr"


@dataclass(frozen=True)
class Target:
    """Where a bake goes: ``carrier`` is "vertex", "texture" or "auto"; atlases lie in ``folder``
    and are called ``stem``, or are packed into the .blend where there is no folder."""

    carrier: str = "vertex"
    folder: Path | None = None
    stem: str = "Untitled"

    def check(self, engine_images: str = "") -> None:
        """Refuse, before anything is baked, what cannot be written."""
        if self.carrier == "vertex":
            return
        if self.folder is not None:
            path = self.folder / (self.stem + " PRT" + SUFFIX)
            outputs.check([path])
            _check_ours(path)
        elif engine_images:
            raise BakeError(
                "Images for engines are files: save the .blend first, and do not pack its textures"
            )


def job_hash(path: Path) -> str | None:
    """Which bake the atlas at ``path`` is of; None where it is none of ours, or not there."""
    try:
        with path.open("rb") as file:
            head = file.read(HEADER)
    except OSError:
        return None
    found = re.search(MARK + rb"\0string\0(....)", head, re.DOTALL)
    if found is None:
        return None
    length = int.from_bytes(found[1], "little")
    return head[found.end() : found.end() + length].decode("ascii", "replace")


def paths(target: Target, members: Sequence[Sequence[str]]) -> list[Path]:
    """A file for each atlas, of the objects called ``members``; BakeError where one of these names
    is taken by a file of the artist's."""
    assert target.folder is not None
    baked = {name for names in members for name in names}
    taken = {path for obj, path in _shown() if obj.name not in baked}
    found: list[Path] = []
    for names in members:
        label = "" if len(names) > 1 or len(members) == 1 else " " + _plain(names[0])
        stem, number = f"{target.stem} PRT{label}", 1
        path = target.folder / (stem + SUFFIX)
        while taken & {path.absolute(), _direct(path).absolute()}:
            number += 1
            path = target.folder / f"{stem} {number}{SUFFIX}"
        _check_ours(path)
        taken |= {path.absolute(), _direct(path).absolute()}
        found.append(path)
    return found


def direct_path(path: Path) -> Path:
    """Where the atlas at ``path`` goes without light that bounced; BakeError where that is a file
    of the artist's."""
    _check_ours(_direct(path))
    return _direct(path)


def beside(path: Path, source: Path, files: Sequence[Path]) -> list[Path]:
    """Where the images for engines ``files`` of the atlas ``source`` go, if that goes to ``path``;
    BakeError where one of these names is taken by a file of the artist's."""
    found = [path.with_name(path.stem + file.name.removeprefix(source.stem)) for file in files]
    for target in found:
        _check_ours(target)
    return found


@contextmanager
def placed(sources: Sequence[Path], targets: Sequence[Path]) -> Iterator[None]:
    """``sources`` have been copied to ``targets`` inside, and what these outdate is gone;
    on an error there all is as it was.  BakeError where there is no room or no right to."""
    moved: list[tuple[Path, Path]] = []
    try:
        with outputs.staged(list(targets)) as places:
            for source, target in zip(sources, targets, strict=True):
                shutil.copyfile(source, places[target])
            for target in [*targets, *_outdated(targets)]:
                if target.exists():
                    kept = target.with_name(f".prt-{secrets.token_hex(4)}{target.suffix}")
                    target.rename(kept)
                    moved.append((target, kept))
        yield
    except BaseException:
        for target in targets:
            target.unlink(missing_ok=True)
        for target, kept in moved:
            kept.replace(target)
        raise
    for _, kept in moved:
        kept.unlink(missing_ok=True)


def path_of(image: bpy.types.Image) -> Path | None:
    """Where ``image`` lies; None where it is packed."""
    if image.packed_file is not None or not image.filepath:
        return None
    return Path(bpy.path.abspath(image.filepath, library=image.library)).absolute()


def _shown() -> Iterator[tuple[bpy.types.Object, Path]]:
    """Baked objects and the files that they show."""
    for obj in bpy.data.objects:
        image = stamp.image_of(obj)
        path = path_of(image) if image is not None else None
        if path is not None:
            yield obj, path
            yield obj, _direct(path)


def _direct(path: Path) -> Path:
    return path.with_name(f"{path.stem}_direct{path.suffix}")


def _outdated(targets: Sequence[Path]) -> list[Path]:
    """What earlier bakes left without light that bounced beside atlases of theirs that ``targets``
    are written over."""
    beside = {_direct(path) for path in targets} - set(targets)
    return sorted(path for path in beside if _is_ours(path))


def _check_ours(path: Path) -> None:
    if path.exists() and not _is_ours(path):
        raise BakeError(
            f"{path} is a picture of yours, and the bake would be called so: rename it, or choose "
            "another folder"
        )


def _is_ours(path: Path) -> bool:
    """Whether the file at ``path`` says that a bake has written it."""
    try:
        with path.open("rb") as file:
            return MARK in file.read(HEADER)
    except OSError:
        return False


def _plain(name: str) -> str:
    """``name`` without what no file can be called."""
    return re.sub(r'[<>:"/\\|?*\0-\x1f]', "_", name).strip(". ") or "_"
