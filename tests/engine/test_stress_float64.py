"""The float32 engine against one in float64, along the same rays.

The reference meets triangles by signed volumes in float64 and sums the basis over world
directions.  It learns the engine's directions from the rays that a bake casts: those of a point are
the Fibonacci set about its normal, turned by one azimuth.
"""

import numpy as np
import pytest
import shapes
from prt_baker.addon.prt import sh
from prt_baker.addon.prt.run import run
from prt_baker.addon.prt.steps import value_of
from prt_baker.addon.prt.surface import points
from prt_baker.addon.prt.tracing import rays
from prt_baker.addon.prt.tracing.hemisphere import cosine_fibonacci
from prt_baker.addon.prt.tracing.transfer import relative_rms
from stressing import job_of, needles, receiver, turned
from test_stress_meshes import torus

pytestmark = pytest.mark.filterwarnings("error")

RAYS = 256
GRAZING = 1e-6  # of the signed volumes: what float32 cannot tell from an edge


@pytest.fixture
def cast(monkeypatch):
    """Origins, directions and whether the sky was reached, of every ray that Embree traces."""
    seen = []
    trace = rays.Triangles.sky_mask

    def traced(self, origins, directions):
        mask = trace(self, origins, directions)
        seen.append((origins.copy(), directions.copy(), np.asarray(mask) != rays.BLOCKED))
        return mask

    monkeypatch.setattr(rays.Triangles, "sky_mask", traced)
    return lambda: tuple(np.concatenate(arrays) for arrays in zip(*seen, strict=True))


def met(origin, directions, corners):
    """Whether rays (R, 3) from ``origin`` meet triangles (F, 3, 3), and whether an edge passed so
    close that it decides."""
    a, b, c = (corners[:, k] - origin for k in range(3))
    volumes = np.stack([directions @ np.cross(p, q).T for p, q in ((b, c), (c, a), (a, b))])
    facing = np.sign(volumes.sum(axis=0))
    nearest = (volumes * facing).min(axis=0)
    towards = directions @ np.cross(b - a, c - a).T
    ahead = np.einsum("fc,fc->f", a, np.cross(b - a, c - a)) * towards > 0
    grazed = np.abs(nearest) < GRAZING * np.abs(volumes).sum(axis=0)
    hit = ahead & (nearest > 0)
    sure = (hit & ~grazed).any(axis=1)
    return hit.any(axis=1), (ahead & grazed).any(axis=1) & ~sure


def frame(normal):
    """Some orthonormal axes (3, 3), columns, the third being ``normal``."""
    side = np.cross(normal, np.eye(3)[np.abs(normal).argmin()])
    side /= np.linalg.norm(side)
    return np.stack([side, np.cross(normal, side), normal], axis=1)


def all_directions(normal, found):
    """The set (N, 3) about ``normal`` of which ``found`` (R, 3) are some, and their places in it
    (R,), -1 where they are of another set."""
    local = found @ frame(normal)
    ring = (1 - local[:, 2] ** 2) * RAYS - 0.5
    place = np.rint(ring).astype(np.int64)
    place[np.abs(ring - place) > 0.1] = -1
    flat = cosine_fibonacci(RAYS)[:, :2] @ [1, 1j]
    turn = ((local[:, 0] + 1j * local[:, 1]) / flat[place])[place > RAYS // 16]
    turn = turn.mean() if len(turn) else 1 + 0j
    xy = flat * turn / abs(turn)
    whole = np.stack([xy.real, xy.imag, cosine_fibonacci(RAYS)[:, 2]], axis=1)
    return whole @ frame(normal).T, place


def in_float64(where, corners, cast_rays, order):
    """Transfer (P, n²), and how many rays grazed an edge, and disagreed elsewhere."""
    origins, directions, clear = cast_rays
    transfer, grazing, wrong = np.empty((len(where.origins), order**2)), 0, 0
    normals = where.normals.astype(np.float64)
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    for p, (start, normal) in enumerate(zip(where.origins, normals, strict=True)):
        mine = (origins == start).all(axis=1)
        whole, place = all_directions(normal, directions[mine].astype(np.float64))
        theirs = np.ones(RAYS, bool)  # what was not traced is taken to be clear
        theirs[place[place >= 0]] = clear[mine][place >= 0]
        hit, close = met(start.astype(np.float64), whole, corners)
        wrong += np.count_nonzero((theirs == hit) & ~close)
        grazing += np.count_nonzero(close)
        visible = np.where(close, theirs, ~hit)
        values = sh.basis(whole, order)
        missing = sh.open_transfer(normal, order) - values.mean(axis=0)
        transfer[p] = visible @ values / RAYS + visible.mean() * missing
    return transfer, grazing, wrong


def soup(seed):
    rng = np.random.default_rng(seed)
    corners = rng.uniform(-2, 2, (300, 1, 3)) + rng.normal(0, 0.3, (300, 3, 3))
    return corners.reshape(-1, 3), np.arange(900).reshape(-1, 3)


def knot():
    mesh = shapes.torus_knot(12, 5)
    floor = shapes.grid([-2.5, -2.5, -1], [5, 0, 0], [0, 5, 0], 5)
    wall = shapes.grid([-2.5, 1.9, -1], [5, 0, 0], [0, 0, 4], 4)
    return receiver(*mesh), *shapes.join(mesh[:2], floor, wall)


def ball_in_soup():
    ball = shapes.sphere(4, 12)
    return receiver(*ball), *shapes.join(ball[:2], soup(1))


def sheet_in_soup():
    sheet = shapes.grid([-1, -1, 0], [2, 0, 0], [0, 2, 0], 6)
    turn = turned()
    vertices, triangles = shapes.join((sheet[0] @ turn.T, sheet[1]), soup(2))
    return receiver(sheet[0] @ turn.T, sheet[1]), vertices, triangles


def well():
    vertices, triangles = shapes.box(2.0, 3)
    top = (vertices[triangles][:, :, 2] > 0.999).all(axis=1)
    vertices = vertices @ turned().T
    return receiver(vertices, triangles[~top]), vertices, triangles[~top]


def ring_between_needles():
    ring = torus(8, 6)
    fence = needles([-2, 0, -3], [4, 0, 0], [0.3, 0.2, 6], 200)
    fence = fence[0], fence[1][::2]  # every other one, so that light passes
    return receiver(*ring), *shapes.join(ring[:2], fence)


def far_and_small():
    subject, vertices, triangles = well()
    return receiver(subject.vertices * 1e-4, triangles), vertices * 1e-4, triangles


def pile():
    """The middle one of three boxes that stand on each other, faces coincident."""
    box, triangles = shapes.box(1.0, 2, inward=False)
    boxes = [((box + np.array([0, 0, k])) @ turned().T, triangles) for k in (0, 1, 2)]
    return receiver(*boxes[1]), *shapes.join(*boxes)


def bent_sheet():
    """A sheet with the slightest fold, its points seeing a little of each other."""
    vertices, triangles = shapes.grid([-1, -1, 0], [2, 0, 0], [0, 2, 0], 6)
    vertices[:, 2] = 1e-2 * np.abs(vertices[:, 0])
    return receiver(vertices @ turned().T, triangles), vertices @ turned().T, triangles


def dented_dome():
    """A convex dome but for one vertex, pressed in a little."""
    vertices, triangles = shapes.grid([-1, -1, 0], [2, 0, 0], [0, 2, 0], 4)
    vertices[:, 2] = -0.1 * (vertices[:, :2] ** 2).sum(axis=1)
    vertices[12, 2] -= 0.05
    return receiver(vertices, triangles), vertices, triangles


def just_above_the_horizon():
    """A floor, and far away a ridge that rises above it by a hundredth of its distance."""
    floor = shapes.grid([-1, -1, 0], [2, 0, 0], [0, 2, 0], 6)
    ridge = shapes.grid([5, -9, -0.05], [0, 18, 0], [0, 0, 0.1], 3)
    turn = turned()
    vertices, triangles = shapes.join(floor, ridge)
    return receiver(floor[0] @ turn.T, floor[1]), vertices @ turn.T, triangles


SCENES = [
    knot,
    ball_in_soup,
    sheet_in_soup,
    well,
    ring_between_needles,
    far_and_small,
    pile,
    bent_sheet,
    dented_dome,
    just_above_the_horizon,
]


@pytest.mark.parametrize("order", [3, 5])
@pytest.mark.parametrize("make", SCENES)
def test_float32_and_float64_agree(make, order, cast, record_property):
    """About 50 points among some hundred triangles (knot, soups, well, needles, scale 1e-4,
    coincident boxes, nearly flat and nearly convex sheets), orders 3 and 5, against an engine in
    float64 along the same rays: transfer to 1e-5 (RMS and largest), no ray differs but those that
    graze an edge within 1e-6, at most 1 in 1,000."""
    subject, vertices, triangles = make()
    where = points.distinct_points(subject)
    results = value_of(run(job_of([subject], vertices, triangles, rays=RAYS, order=order)))
    transfer = results.receivers[0].transfer[:, 0]
    corners = np.asarray(vertices, np.float32).astype(np.float64)[triangles]
    expected, grazing, wrong = in_float64(where, corners, cast(), order)
    error = max(relative_rms(transfer, expected), np.abs(transfer - expected).max())
    record_property("measured", error)
    record_property("count", grazing)
    assert error < 1e-5
    assert wrong == 0
    assert grazing <= 1e-3 * RAYS * len(where.origins)
