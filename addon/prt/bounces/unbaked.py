"""Places on what rays meet and no receiver is: other objects, and the backs of open sheets.

They are found in rounds.  The rays of the receivers end at some entries; a place in every patch of
those is traced, with fewer rays than a point has, since a ray sees many of them; and the rays of
these may end at more, which only light that bounces once more needs.
"""

from collections import Counter
from collections.abc import Generator

import numpy as np
import numpy.typing as npt

from ..slices import slices
from ..surface.points import Points, morton_order, surface_bias
from ..tracing.buried import buried, is_dark, rays_for
from ..tracing.rays import Occlusion
from ..tracing.transfer import Counts
from .entries import Entries
from .hits import Gathered
from .keeper import Trace
from .patches import Keys, keys_of, patches

Array = npt.NDArray[np.float32]
Index = npt.NDArray[np.int64]
Float = npt.NDArray[np.float64]
Mask = npt.NDArray[np.bool_]

SHARE, FEWEST = 2, 32  # of a point's rays
PIECE = 1 << 16  # cells that are looked at together
ROUNDS = 6  # what is found only after so many takes part in nothing


class Unbaked:
    """Nodes of entries that are no points of receivers, numbered from ``first_node`` on.

    ``nodes`` (2 count,) are those of every entry, -1 for none; ``values`` and ``gathered`` what was
    found there and what the rays met, round by round; ``unseen``, places inside of other things,
    whose light nothing needs; ``counts``, the rays, and ``looks``, those that told what lies
    inside, by ``occlusion``.
    """

    nodes: npt.NDArray[np.int32]
    values: list[Array]
    gathered: list[Gathered | None]
    unseen: list[Mask]
    counts: Counts

    def __init__(
        self,
        entries: Entries,
        vertices: Float,
        triangles: Index,
        occlusion: Occlusion,
        first_node: int,
    ) -> None:
        self._entries, self._vertices, self._triangles = entries, vertices, triangles
        self._occlusion, self._first_node, self.looks = occlusion, first_node, 0
        nodes = np.full(2 * entries.count, -1, np.int32)
        nodes[: entries.count] = entries.points
        self.nodes, self.values, self.gathered, self.unseen = nodes, [], [], []
        self._patches: list[tuple[Keys, Index]] = []
        self.counts = Counter()

    @property
    def places(self) -> int:
        """How many there are."""
        return sum(map(len, self.values))

    def add(self, used: Index, trace: Trace, rays: int, last: bool) -> Generator[int, None, None]:
        """Trace places for those of the entries ``used`` (U,) that have no node; where these are
        the ``last``, what their rays meet is not looked at.  Yields the rays cast so far."""
        new = used[self.nodes[used] < 0]
        if not len(new):
            return
        points, of_cells, inside, keys = self._places(new)
        order = morton_order(points.origins)
        places = Points(points.origins[order], points.normals[order], points.element_points)
        few = max(FEWEST, rays // SHARE)
        values, gathered, counts = yield from trace(places, few, not last)
        numbers = np.empty(len(order), np.int64)
        numbers[order] = self._first_node + self.places + np.arange(len(order))
        self.nodes[new] = numbers[of_cells]
        self._patches.append((keys, numbers[: len(keys)]))
        self.values.append(values)
        self.gathered.append(gathered)
        self.unseen.append(inside[order] & is_dark(values))
        self.counts += counts

    def spread(self) -> None:
        """Give all other cells of the patches that were found their nodes as well: what was looked
        from so far met others of these, and what comes may meet any."""
        if not self._patches:
            return
        keys, numbers = (np.concatenate(its) for its in zip(*self._patches, strict=True))
        names, first = np.unique(keys, return_index=True)
        left = np.flatnonzero(self.nodes < 0)
        for some in slices(len(left), PIECE):
            its = self._keys(self._points(left[some]))
            at = np.minimum(np.searchsorted(names, its), len(names) - 1)
            self.nodes[left[some]] = np.where(names[at] == its, numbers[first[at]], -1)

    def _keys(self, cells: Points) -> Keys:
        """Names of the patches (E,) of ``cells``."""
        centres, normals = cells.origins.astype(np.float64), cells.normals.astype(np.float64)
        return keys_of(centres, normals, self._entries.side)

    def _places(self, cells: Index) -> tuple[Points, Index, Mask, Keys]:
        """A place for every patch of the entries ``cells`` (E,), and for each cell of its own where
        the patch's lies inside of something and the cell's does not, nearer to a corner: beside
        a thin wall it would be dark.  The place of each cell (E,); which lie inside; and the keys
        of the patches, whose places come first."""
        its = self._points(cells)
        found = patches(its.origins.astype(np.float64), self._keys(its))
        of_patches, inside = self._seen_points(cells[found.middle], ((cells[found.rim], None),))
        alone = np.flatnonzero(inside[found.of_cells])
        corners = tuple((cells[alone], k) for k in range(3))
        own, hidden = self._seen_points(cells[alone], corners)
        seen, of_cells = np.flatnonzero(~hidden), found.of_cells.copy()
        of_cells[alone[seen]] = len(inside) + np.arange(len(seen))
        origins = np.concatenate([of_patches.origins, own.origins[seen]])
        facing = np.concatenate([of_patches.normals, own.normals[seen]])
        inside = np.concatenate([inside, np.zeros(len(seen), bool)])
        return Points(origins, facing, of_patches.element_points), of_cells, inside, found.keys

    def _seen_points(
        self, entries: Index, others: tuple[tuple[Index, int | None], ...]
    ) -> tuple[Points, Mask]:
        """As ``_points`` of ``entries`` (G,), where these lie inside of something from the first of
        the ``others``, as ``_points`` takes them, that does not.  And which (G,) have none."""
        found = self._points(entries)
        hidden = np.flatnonzero(self._are_inside(found))
        for its_entries, towards in others:
            if not len(hidden):
                break
            its = self._points(its_entries[hidden], towards)
            inside = self._are_inside(its)
            seen = hidden[~inside]
            found.origins[seen], found.normals[seen] = its.origins[~inside], its.normals[~inside]
            hidden = hidden[inside]
        return found, np.bincount(hidden, minlength=len(entries)) > 0

    def _are_inside(self, places: Points) -> Mask:
        """Which of ``places`` lie inside of other things."""
        if not len(places.origins):
            return np.zeros(0, bool)
        dark = np.zeros((len(places.origins), 1), np.float32)
        self.looks += rays_for(dark)
        return buried(places.origins, places.normals, dark, self._occlusion)

    def _points(self, entries: Index, towards: int | None = None) -> Points:
        """Where the rays of ``entries`` (E,) start, in float32, with geometric normals."""
        triangles, barycentric = self._entries.places(entries, towards)
        corners = self._vertices[self._triangles[triangles]].astype(np.float64)
        cross = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        normals = cross / np.maximum(np.linalg.norm(cross, axis=1, keepdims=True), 1e-300)
        normals[entries >= self._entries.count] *= -1
        origins = np.einsum("ek,ekc->ec", barycentric, corners) + surface_bias(corners) * normals
        return Points(origins.astype(np.float32), normals.astype(np.float32), np.empty(0, np.int32))
