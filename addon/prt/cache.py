"""What was traced, kept on disk: an object that nothing has changed for is not traced again.

An entry is one file, named by the hash of all that decides it: a line, the arrays' names, types and
shapes as JSON, the arrays, and a checksum.  Entries are written under another name and renamed, and
never changed, so that several processes can share a folder.  Whatever goes wrong with it, a full
disk or a damaged file, costs time and no bake.
"""

import contextlib
import hashlib
import json
import os
import time
import zlib
from collections.abc import Iterator, Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, BinaryIO, Literal

import numpy as np
import numpy.typing as npt

from . import VERSION
from .digests import add_array
from .job import RECEIVER_ARRAYS, Array, Job, light_digest

What = Literal["result", "visibility", "pilot"]

LIMIT_BYTES = 2 << 30
MAGIC = b"PRT Baker's cache, entry of version 3\n"
SUFFIX, UNFINISHED = ".prt", ".tmp"
ABANDONED_SECONDS = 3600.0  # an unfinished file this old is left from a process that was killed
SPARE = 16  # part of the limit that is made free at once, so that a full folder is seldom looked at
ALIGNMENT = 64
LENGTH_BYTES, CHECKSUM_BYTES, DIGEST_BYTES = 8, 4, 32
LEAST_BYTES = len(MAGIC) + LENGTH_BYTES + CHECKSUM_BYTES
# what changes no result, and what changes none as long as no light is looked at
ATLAS = (
    "resolution",
    "texel_density",
    "shared_atlas",
    "padding_mip",
    "half",
    "engine_images",
)  # UVs tell
NEVER = ("threads", "cache", "verify_points", "verify_rays", "reflections", *ATLAS)
BY_LIGHT = ("residual", "map_rays", "turns", "peaks", "final_light")


@dataclass(frozen=True)
class Entry:
    """What was put: read-only ``arrays`` by name, and ``report``, plain JSON."""

    arrays: dict[str, Array]
    report: dict[str, Any]


class Cache:
    """Entries in ``folder``, at most ``limit_bytes`` of them: those not used for the longest time
    are deleted first.  "" is no folder: nothing is kept.

    The folder is looked at when there may be no room left, which this object knows of what it
    writes itself; what other processes write meanwhile is counted then."""

    def __init__(self, folder: str | Path, limit_bytes: int = LIMIT_BYTES) -> None:
        self._folder = Path(folder) if folder else None
        self._limit, self._room = limit_bytes, 0

    def get(self, key: str) -> Entry | None:
        """The entry of ``key``, memory-mapped; None where there is none that is whole."""
        if self._folder is None:
            return None
        path = self._folder / (key + SUFFIX)
        try:
            data: Array = np.memmap(path, np.uint8, "r")
        except (OSError, ValueError):  # missing, or empty
            return None
        if not _is_whole(data):
            _delete(path)
            return None
        with contextlib.suppress(OSError):  # a folder that may only be read keeps no order
            os.utime(path)
        return _entry(data)

    def put(self, key: str, arrays: Mapping[str, Array], report: Mapping[str, Any]) -> bool:
        """Keep ``arrays`` and ``report`` under ``key``; whether that was possible."""
        size = sum(array.nbytes for array in arrays.values())
        if self._folder is None or size > self._limit:
            return False
        try:
            self._folder.mkdir(parents=True, exist_ok=True)
            if size >= self._room:
                self._room = self._limit - self._trimmed(self._folder, size)
            self._room -= _write(self._folder, key, arrays, report)
        except OSError:
            return False
        return True

    def _trimmed(self, folder: Path, size: int) -> int:
        """The bytes in ``folder``, where there is room for ``size`` more: what was used longest ago
        is deleted if there is not, and some more with it."""
        files, now = sorted(_files(folder), reverse=True), time.time()
        abandoned = [path for used, _, path in files if _is_abandoned(path, now - used)]
        kept = [file for file in files if file[2].suffix == SUFFIX]
        total = sum(its for _, its, _ in kept)
        limit = self._limit - size
        if total > limit:
            limit = min(limit, self._limit - self._limit // SPARE)
        for path in abandoned:
            _delete(path)
        while kept and total > limit:
            _, freed, path = kept.pop()
            _delete(path)
            total -= freed
        return total


class Keys:
    """Names for what can be kept of ``job``.  Each part of it is hashed once, when it is needed."""

    def __init__(self, job: Job) -> None:
        self._job = job
        self._settings = asdict(job.settings)
        count = len(job.occluder_starts) - 1
        self._parts, self._has = np.empty((count, DIGEST_BYTES), np.uint8), np.zeros(count, bool)
        self._light: bytes | None = None

    def receiver(
        self, what: What, index: int, parts: npt.ArrayLike, with_light: bool, more: bytes = b""
    ) -> str:
        """Names ``what`` of receiver ``index``: it depends on its arrays, on the occluders
        ``parts``, whatever their order and their names, on the settings that decide it and on this
        program's version; on the light and its settings only where ``with_light``; and on ``more``
        that the caller knows of."""
        job = self._job
        receiver = job.receivers[index]
        without: tuple[str, ...] = NEVER if with_light else NEVER + BY_LIGHT
        without += ("bounces", "visibility_order") if what == "visibility" else ()
        without += ("keep_direct",) if what != "result" else ()
        settings = {k: v for k, v in self._settings.items() if k not in without}
        header = (VERSION, what, receiver.domain, settings, with_light)
        digest = hashlib.blake2b(digest_size=20)
        digest.update(json.dumps(header, sort_keys=True).encode())
        digest.update(more)
        for name in RECEIVER_ARRAYS:
            add_array(digest, name, getattr(receiver, name))
        digest.update(self._digests(np.asarray(parts, np.int64)))
        if with_light:
            self._light = self._light or light_digest(job.light)
            digest.update(self._light)
        return digest.hexdigest()

    def _digests(self, parts: npt.NDArray[np.int64]) -> npt.NDArray[np.uint8]:
        """Names of the triangles of occluders (K,) and where they are (K, DIGEST_BYTES), sorted."""
        for k in parts[~self._has[parts]]:
            self._parts[k] = np.frombuffer(self._digest(int(k)), np.uint8)
            self._has[k] = True
        its = self._parts[parts]
        return its[np.argsort(its.view(">u8")[:, 0], kind="stable")]

    def _digest(self, k: int) -> bytes:
        job, digest = self._job, hashlib.blake2b(digest_size=DIGEST_BYTES)
        triangles = job.occluder_triangles[job.occluder_starts[k] : job.occluder_starts[k + 1]]
        low = int(triangles.min(initial=len(job.occluder_vertices)))
        high = int(triangles.max(initial=-1)) + 1
        add_array(digest, "vertices", job.occluder_vertices[low:high])
        add_array(digest, "triangles", triangles - low)
        return digest.digest()


def _files(folder: Path) -> Iterator[tuple[float, int, Path]]:
    """When each file of the cache was last used, its bytes, and its path."""
    with os.scandir(folder) as entries:
        for entry in entries:
            if entry.name.endswith((SUFFIX, UNFINISHED)):
                with contextlib.suppress(OSError):  # another process was faster
                    status = entry.stat()
                    yield status.st_mtime, status.st_size, Path(entry.path)


def _is_abandoned(path: Path, age: float) -> bool:
    return path.suffix == UNFINISHED and age > ABANDONED_SECONDS


def _delete(path: Path) -> None:
    with contextlib.suppress(OSError):  # gone, or mapped by another process on Windows
        path.unlink()


def _write(folder: Path, key: str, arrays: Mapping[str, Array], report: Mapping[str, Any]) -> int:
    """The bytes written; OSError where there is no room, and then nothing is left of it."""
    unfinished = folder / f"{key}-{os.urandom(8).hex()}{UNFINISHED}"
    try:
        with unfinished.open("xb") as file:
            _write_entry(file, arrays, report)
            size = file.tell()
        unfinished.replace(folder / (key + SUFFIX))
    except BaseException:
        _delete(unfinished)
        raise
    return size


def _write_entry(file: BinaryIO, arrays: Mapping[str, Array], report: Mapping[str, Any]) -> None:
    plain = {name: np.ascontiguousarray(array) for name, array in arrays.items()}
    shapes = [(name, array.dtype.str, array.shape) for name, array in plain.items()]
    header = json.dumps({"arrays": shapes, "report": dict(report)}).encode()
    head = MAGIC + len(header).to_bytes(LENGTH_BYTES, "little") + header
    pieces: list[Any] = [head, b"\0" * (-len(head) % ALIGNMENT)]
    for array in plain.values():
        pieces += [array.reshape(-1).view(np.uint8), b"\0" * (-array.nbytes % ALIGNMENT)]
    checksum = 0
    for piece in pieces:
        file.write(piece)
        checksum = zlib.crc32(piece, checksum)
    file.write(checksum.to_bytes(CHECKSUM_BYTES, "little"))


def _is_whole(data: npt.NDArray[np.uint8]) -> bool:
    if len(data) < LEAST_BYTES or data[: len(MAGIC)].tobytes() != MAGIC:
        return False
    checksum = int.from_bytes(data[-CHECKSUM_BYTES:].tobytes(), "little")
    return zlib.crc32(data[:-CHECKSUM_BYTES]) == checksum


def _entry(data: npt.NDArray[np.uint8]) -> Entry:
    """The views of a whole entry."""
    start = len(MAGIC) + LENGTH_BYTES
    end = start + int.from_bytes(data[len(MAGIC) : start].tobytes(), "little")
    header = json.loads(data[start:end].tobytes())
    arrays = {}
    for name, dtype, shape in header["arrays"]:
        first = end + -end % ALIGNMENT
        end = first + int(np.prod(shape)) * np.dtype(dtype).itemsize
        arrays[name] = np.asarray(data[first:end]).view(dtype).reshape(shape)
    return Entry(arrays, header["report"])
