"""Which rays reach the sky: embreex behind a protocol, with toy twins for tests.

The only module that imports embreex.
"""

import logging
from dataclasses import dataclass
from threading import Lock
from typing import Any, Protocol

import numpy as np
import numpy.typing as npt

from ..errors import BakeError
from ..parallel import workers

Vectors = npt.NDArray[np.float32]
Mask = npt.NDArray[np.int32]
CLEAR, BLOCKED = -1, 0  # embreex's own codes
ONE = np.float32(1).view(np.int32)  # CLEAR has all of its bits, and BLOCKED none
PIECE = 8192  # rays
FAST_PAYS = 120  # rays a triangle: what they save pays twice for the second structure


def as_visible(mask: Mask) -> Vectors:
    """1 where ``mask`` (R,) is CLEAR and 0 where it is BLOCKED, in its own memory."""
    mask &= ONE
    return mask.view(np.float32)


class Occlusion(Protocol):
    """Anything that stops rays.  Safe to call from several threads."""

    def sky_mask(self, origins: Vectors, directions: Vectors) -> Mask:
        """For rays (R, 3), (R, 3): CLEAR (-1) where the sky is reached, else BLOCKED (0)."""
        ...

    @property
    def lets_slip(self) -> bool:
        """Whether a ray in some millions may slip between two triangles of a closed mesh."""
        ...

    def watertight(self) -> "Occlusion":
        """The same things in a form that no ray slips through."""
        ...

    def meets_back(self, origins: Vectors, directions: Vectors) -> npt.NDArray[np.bool_]:
        """For rays (R, 3), (R, 3): whether the first thing met is the back of a triangle."""
        ...


@dataclass(frozen=True)
class Met:
    """What R rays meet first: ``triangles`` (R,) int32, -1 where they reach the sky; the shares
    ``u`` and ``v`` (R,) that the second and third corners have of the place; and the geometric
    normals there, ``facing`` (R, 3), of any length."""

    triangles: Mask
    u: Vectors
    v: Vectors
    facing: Vectors


class Geometry(Occlusion, Protocol):
    """Triangles that rays meet."""

    def watertight(self) -> "Geometry":
        """The same triangles in a form that no ray slips through."""
        ...

    def first_met(self, origins: Vectors, directions: Vectors) -> Met:
        """What rays (R, 3), (R, 3) meet first."""
        ...


class Sky:
    """Nothing is hit."""

    lets_slip = False

    def watertight(self) -> Geometry:
        """It is."""
        return self

    def sky_mask(self, origins: Vectors, directions: Vectors) -> Mask:  # noqa: ARG002 - no shape
        """CLEAR for every ray."""
        return np.full(len(directions), CLEAR, np.int32)

    def meets_back(self, origins: Vectors, directions: Vectors) -> npt.NDArray[np.bool_]:  # noqa: ARG002 - no shape
        """No ray meets the back of anything."""
        return np.zeros(len(directions), bool)

    def first_met(self, origins: Vectors, directions: Vectors) -> Met:  # noqa: ARG002 - no shape
        """No ray meets anything."""
        nothing = np.zeros(len(directions), np.float32)
        triangles = np.full(len(directions), -1, np.int32)
        return Met(triangles, nothing, nothing, np.zeros((len(directions), 3), np.float32))


class Lid:
    """Everything is hit."""

    lets_slip = False

    def watertight(self) -> Occlusion:
        """It is."""
        return self

    def sky_mask(self, origins: Vectors, directions: Vectors) -> Mask:  # noqa: ARG002 - no shape
        """BLOCKED for every ray."""
        return np.full(len(directions), BLOCKED, np.int32)

    def meets_back(self, origins: Vectors, directions: Vectors) -> npt.NDArray[np.bool_]:  # noqa: ARG002 - no shape
        """No ray meets the back of anything."""
        return np.zeros(len(directions), bool)


class _Failures(logging.Handler):
    """embreex only logs the device's errors; this keeps them so that they can be raised."""

    def __init__(self) -> None:
        super().__init__(logging.WARNING)
        self.messages: list[str] = []

    def emit(self, record: logging.LogRecord) -> None:
        self.messages.append(record.getMessage())


class Triangles:
    """The triangles of a scene, in Embree.

    The ``fast`` mode takes 0.75 to 0.85 of the time a ray and lets one in some millions slip, more
    of those that are aimed along an edge; its ``watertight`` form is built when it is asked for.
    """

    def __init__(
        self,
        vertices: npt.ArrayLike,
        triangles: npt.ArrayLike,
        fast: bool = False,
        threads: int = 0,
    ) -> None:
        self._vertices, self._triangles, self._threads = vertices, triangles, threads
        self._scene = _embree_scene(vertices, triangles, robust=not fast)
        self._robust, self._building = None if fast else self, Lock()

    @property
    def lets_slip(self) -> bool:
        """In the fast mode."""
        return self._robust is not self

    def watertight(self) -> Geometry:
        """In Embree's robust mode."""
        with self._building:
            if self._robust is None:
                self._robust = Triangles(self._vertices, self._triangles, threads=self._threads)
            return self._robust

    def sky_mask(self, origins: Vectors, directions: Vectors) -> Mask:
        """What Embree's occlusion query finds; releases the interpreter's lock."""
        mask: Mask = self._scene.run(origins, directions, query="OCCLUDED")
        return mask

    def meets_back(self, origins: Vectors, directions: Vectors) -> npt.NDArray[np.bool_]:
        """From Embree's geometric normals of what is met first; in threads."""

        def some(start: int) -> npt.NDArray[np.bool_]:
            towards = directions[start : start + PIECE]
            met = self.first_met(origins[start : start + PIECE], towards)
            along = np.einsum("rc,rc->r", met.facing, towards)
            return np.asarray((met.triangles >= 0) & (along > 0))

        starts = range(0, len(directions), PIECE)
        with workers(self._threads, is_little=len(directions) <= PIECE) as pool:
            return np.concatenate([np.zeros(0, bool), *pool.map(some, starts)])

    def first_met(self, origins: Vectors, directions: Vectors) -> Met:
        """What Embree's intersection query finds; releases the interpreter's lock."""
        hits = self._scene.run(origins, directions, query="INTERSECT", output=True)
        return Met(*(np.asarray(hits[name]) for name in ("primID", "u", "v", "Ng")))


def _embree_scene(vertices: npt.ArrayLike, triangles: npt.ArrayLike, robust: bool) -> Any:
    """A committed scene; BakeError where Embree refuses it."""
    from embreex import rtcore_scene
    from embreex.mesh_construction import TriangleMesh

    failures = _Failures()
    logger = logging.getLogger("embreex")
    logger.addHandler(failures)
    try:
        scene = rtcore_scene.EmbreeScene(robust=robust)
        corners, faces = np.asarray(vertices, np.float32), np.asarray(triangles, np.int32)
        TriangleMesh(scene, corners.astype(object), _tuples(faces))
        one_ray = np.array([[0.0, 0.0, 1.0]], np.float32)
        scene.run(one_ray, one_ray, query="OCCLUDED")  # commits, before threads start
    finally:
        logger.removeHandler(failures)
    if failures.messages:
        raise BakeError(
            f"Embree could not take the scene's {len(corners):,} vertices "
            f"({failures.messages[0]}): hide what casts no shadow on the baked objects"
        )
    return scene


def _tuples(triangles: Mask) -> npt.NDArray[np.object_]:
    """The triangles (F, 3) as F tuples of Python's numbers: embreex takes one number after the
    other, and takes half the time where no array has to be made for each triangle."""
    numbers = np.arange(triangles.max(initial=-1) + 1).astype(object)
    rows = np.empty(len(triangles), object)
    for start in range(0, len(rows), PIECE):
        columns = numbers[triangles[start : start + PIECE].T].tolist()
        rows[start : start + PIECE] = np.fromiter(zip(*columns, strict=True), object)
    return rows


def occlusion(
    vertices: npt.ArrayLike,
    triangles: npt.ArrayLike,
    expected_rays: float = 0,
    threads: int = 0,
) -> Geometry:
    """Embree over ``vertices`` (V, 3) and ``triangles`` (F, 3), in the mode that pays for so many
    rays; the open sky where F is 0."""
    corners, faces = np.asarray(vertices, np.float32), np.asarray(triangles, np.int32)
    if not len(faces):
        return Sky()
    return Triangles(corners, faces, expected_rays > FAST_PAYS * len(faces), threads)
