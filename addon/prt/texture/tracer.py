"""Traces places of texels, tells which of them lie inside of other things, and keeps a record."""

from collections.abc import Generator
from functools import reduce

import numpy as np
import numpy.typing as npt

from ..slices import slices
from ..surface.points import Index, morton_order
from ..surface.samples import Places
from ..tracing.buried import buried, rays_for
from ..tracing.rays import Occlusion
from ..vertex.parts import joined
from ..vertex.traced import FALL, Caster, Trace, Traced
from .cover import Mask
from .places import Array, Mesh
from .stitch import BEYOND, in_atlas

FEWEST = 16  # rays of a place
PIECE = 1 << 16  # places that are found together
GLANCES = 1 << 14  # places that are looked at together
RECORDS = 1 << 19  # texels of which each place that was traced is kept; of more, every second one
NONE = np.zeros(0, np.int64)
NOWHERE = Places(NONE, np.zeros((0, 3)))
CENTRE = np.zeros(2)
QUARTERS = 0.25 * np.array([[-1, -1], [1, -1], [-1, 1], [1, 1]])  # of a texel
ASKEW = 0.125 * np.array([[-1, -3], [3, -1], [-3, 1], [1, 3]])  # of which none share a row
AWAY = 0.5 * np.array([[-1, 0], [1, 0], [0, -1], [0, 1], [-1, -1], [1, -1], [-1, 1], [1, 1]])


class Tracer(Caster):
    """Traces the texels ``index`` (T,) of ``mesh``, which stand on ``triangles`` (T,).

    ``rays`` are those of a place whose share of them is 1; of what is found the first ``order``²
    columns are the transfer.
    """

    def __init__(
        self, mesh: Mesh, index: Index, triangles: Index, trace: Trace, occlusion: Occlusion,
        *, order: int, rays: int,
    ) -> None:  # fmt: skip
        super().__init__(trace)
        self.mesh, self._index, self._triangles = mesh, index, triangles
        self._occlusion, self._order = occlusion, order
        self.rays, self.places = rays, 0
        self._found: list[Traced] = []
        self._inside: list[tuple[Places, Array]] = []
        self._thin = 1 + len(index) // RECORDS

    @property
    def traced(self) -> Traced:
        """What was found, of every place or, where there are many, of some."""
        nothing = np.zeros((0, 3), np.float32)
        start = Traced(nothing, nothing, nothing, NONE, NOWHERE, NONE, np.zeros(0))
        return reduce(Traced.and_, self._found) if self._found else start

    @property
    def inside(self) -> tuple[Places, Array]:
        """The places (M,) inside of texels with an edge between them that are seen, and what was
        found at each (M, K)."""
        if not self._inside:
            return NOWHERE, np.zeros((0, 0), np.float32)
        places, found = zip(*self._inside, strict=True)
        return joined(list(places)), np.concatenate(found)

    def mean_noisier(self) -> float:
        """How many times noisier than a place with all rays those are that were traced, RMS."""
        squares = np.concatenate([np.zeros(0), *(found.noisier for found in self._found)]) ** 2
        return float(np.sqrt(squares.mean())) if len(squares) else 1.0

    def at(self, rows: Index, offset: npt.NDArray[np.float64]) -> Generator[int, None, Places]:
        """The places nearest to ``offset`` texels, (2,) or (M, 2), from the centres of the texels
        ``rows`` (M,), on the triangles that these stand on.  Yields the rays cast so far."""
        offsets = np.broadcast_to(offset, (len(rows), 2))
        found = []
        for some in slices(len(rows), PIECE):
            texels, triangles = self._index[rows[some]], self._triangles[rows[some]]
            found.append(self.mesh.places(texels, triangles, offsets[some]))
            yield self.cast
        return joined(found)

    def follow(self, places: Places, share: float) -> Generator[int, None, tuple[Array, Mask]]:
        """What is found (M, K) at ``places`` (M,) with ``share`` of the rays, and which of them are
        buried.  Yields the rays cast so far."""
        rays = max(FEWEST, round(self.rays * share))
        origins, normals = yield from self._starts(places)
        order = morton_order(origins.astype(np.float64))
        origins, normals = origins[order], normals[order]
        found = yield from self.cast_from(origins, normals, rays)
        if not len(found):
            return found, np.zeros(0, bool)
        transfer = found[:, : self._order**2]
        unseen = buried(origins, normals, transfer, self._occlusion)
        self.cast += rays_for(transfer)
        self.places += len(places)
        self._keep(Traced(origins, normals, found, *self._how(places[order], rays)), ~unseen)
        values, hidden = np.empty_like(found), np.empty_like(unseen)
        values[order], hidden[order] = found, unseen
        return values, hidden

    def _how(
        self, places: Places, rays: int
    ) -> tuple[Index, Places, Index, npt.NDArray[np.float64]]:
        """The rest of what is recorded of ``places``."""
        ones = np.ones(len(places), np.int64)
        noisier = np.full(len(places), (self.rays / rays) ** FALL)
        return -ones, places, rays * ones, noisier

    def _keep(self, traced: Traced, seen: Mask) -> None:
        some = seen & (np.arange(len(seen)) % self._thin == 0)
        self._found.append(traced[some])

    def _starts(self, places: Places) -> Generator[int, None, tuple[Array, Array]]:
        """Origins and normals (M, 3) of ``places``; yields the rays cast so far."""
        origins, normals = np.empty((2, len(places), 3), np.float32)
        for some in slices(len(places), PIECE):
            origins[some], normals[some] = self.mesh.starts(places[some])
            yield self.cast
        return origins, normals

    def glance(self, places: Places) -> Generator[int, None, Mask]:
        """Which ``places`` (M,) are buried, from a few rays each.  Yields the rays cast so far."""
        hidden = np.zeros(len(places), bool)
        for some in slices(len(places), GLANCES):
            origins, normals = self.mesh.starts(places[some])
            dark = np.zeros((len(origins), 1), np.float32)
            hidden[some] = buried(origins, normals, dark, self._occlusion)
            self.cast += rays_for(dark)
            yield self.cast
        return hidden

    def texels(
        self, rows: Index, share: float, sharp: Mask
    ) -> Generator[int, None, tuple[Array, Mask]]:
        """What is found (M, K) at the texels ``rows`` (M,) with ``share`` of the rays, and which of
        them are buried.  Those that are ``sharp`` (M,) start a part of their rays from each of
        QUARTERS, of which those that are seen count."""
        places = yield from self.at(rows[~sharp], CENTRE)
        values, hidden = yield from self.follow(places, share)
        if not sharp.any():
            return values, hidden
        quarters = np.repeat(QUARTERS, int(sharp.sum()), axis=0)
        places = yield from self.at(np.tile(rows[sharp], len(QUARTERS)), quarters)
        found, unseen = yield from self.follow(places, share / len(QUARTERS))
        self._inside.append((places[~unseen], found[~unseen]))
        weights = (~unseen).astype(np.float32).reshape(len(QUARTERS), -1, 1)
        weights[:, (weights == 0).all(axis=0)[:, 0]] = 1
        sums = (found.reshape(len(QUARTERS), weights.shape[1], -1) * weights).sum(axis=0)
        both = np.empty((len(rows), sums.shape[1]), np.float32)
        both[~sharp], both[sharp] = values, sums / weights.sum(axis=0)
        is_hidden = np.empty(len(rows), bool)
        is_hidden[~sharp] = hidden
        is_hidden[sharp] = unseen.reshape(len(QUARTERS), -1).all(axis=0)
        return both, is_hidden

    def look_within(
        self, rows: Index, hidden: Mask, share: float
    ) -> Generator[int, None, tuple[Index, Array]]:
        """What is found (M, K) where the texels (M,) of ``rows`` are seen at each of ASKEW, on
        whichever triangle lies there, with a part of ``share`` of the rays; kept ``inside``, too.
        The centres of ``hidden`` texels (T,) are buried.  Yields the rays cast so far."""
        of, at = [NONE], [NOWHERE]
        for offset in ASKEW:
            found, there = yield from self.mesh.at(self._index[rows], offset)
            row, column = np.divmod(self._index[rows[found]], self.mesh.layout.size)
            away = in_atlas(self.mesh.layout, there) - np.stack([column, row], axis=1) - offset
            near = np.hypot(*away.T) < BEYOND
            of.append(rows[found][near])
            at.append(there[near])
        texels, places = np.concatenate(of), joined(at)
        seen = ~hidden[texels]
        seen[~seen] = ~(yield from self.glance(places[~seen]))
        texels, places = texels[seen], places[seen]
        values, unseen = yield from self.follow(places, share / len(ASKEW))
        texels, places, values = texels[~unseen], places[~unseen], values[~unseen]
        self._inside.append((places, values))
        return texels, values

    def are_buried(self, rows: Index) -> Generator[int, None, Mask]:
        """Which of the texels ``rows`` (M,) are buried.  Yields the rays cast so far."""
        return (yield from self.glance((yield from self.at(rows, CENTRE))))

    def pushed_out(self, rows: Index, region: Index) -> Generator[int, None, tuple[Index, Places]]:
        """Those of the texels ``rows`` (M,) whose centres are buried that have another place half a
        texel from there, in the same ``region`` (F,) of triangles, which is not; and that place.
        Yields the rays cast so far."""
        left, out, places = rows, [NONE], [NOWHERE]
        for offset in AWAY:
            found, there = yield from self.mesh.at(self._index[left], offset)
            hidden = yield from self.glance(there)
            near = np.flatnonzero(found)
            same = region[there.triangles] == region[self._triangles[left[near]]]
            chosen = near[~hidden & same]
            out.append(left[chosen])
            places.append(there[~hidden & same])
            left = np.delete(left, chosen)
        return np.concatenate(out), joined(places)
