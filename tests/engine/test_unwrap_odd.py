"""Whatever a mesh is like, it is unwrapped, or a sentence says why not."""

from dataclasses import replace

import numpy as np
import pytest
import shapes
from prt_baker.addon.prt.atlas import uv_map
from prt_baker.addon.prt.atlas.plane import are_needles
from prt_baker.addon.prt.errors import BakeError
from prt_baker.addon.prt.surface.points import Surface
from unwrapping import bumps, places, shown_areas, unwrapped


def fan(count=50):
    angle = np.linspace(0, 2 * np.pi, count, endpoint=False)
    rim = np.stack([np.cos(angle), np.sin(angle), 0 * angle], axis=1)
    vertices = np.concatenate([[[0, 0, 0], [0, 0, 1.0]], rim])
    triangles = [[0, 1, 2 + k] for k in range(count)]
    return shapes.receiver(vertices, triangles, np.tile([0, 0, 1.0], (count + 2, 1)))


def moebius(count=40):
    t = np.linspace(0, 2 * np.pi, count, endpoint=False)[:, None]
    s = np.array([-0.3, 0.3])
    x, y = (1 + s * np.cos(t / 2)) * np.cos(t), (1 + s * np.cos(t / 2)) * np.sin(t)
    vertices = np.stack([x, y, s * np.sin(t / 2)], axis=2).reshape(-1, 3)
    k = np.arange(count)
    after = (k + 1) % count
    turned = after == 0
    low, high = 2 * after + turned, 2 * after + 1 - turned
    triangles = np.concatenate(
        [np.stack([2 * k, low, high], 1), np.stack([2 * k, high, 2 * k + 1], 1)]
    )
    return shapes.receiver(vertices, triangles, np.tile([0, 0, 1.0], (2 * count, 1)))


def doubled():
    vertices, triangles, normals = bumps(8)
    both = np.concatenate([triangles, triangles[:, ::-1]])
    return shapes.receiver(vertices, both, normals)


def needles():
    vertices, triangles = shapes.grid([0, 0, 0], [1, 0, 0], [0, 1, 0], 8)
    vertices[:, 2] = 0.1 * np.sin(5 * vertices[:, 0])
    vertices[9::9, 1] = vertices[10::9, 1] * (1 - 1e-7)  # a column of slivers
    return shapes.receiver(vertices, triangles, np.tile([0, 0, 1.0], (len(vertices), 1)))


def partly_without_area():
    vertices, triangles, normals = bumps(6)
    triangles[::5, 2] = triangles[::5, 1]
    return shapes.receiver(vertices, triangles, normals)


def screws():
    """A large wall and, before it, thousands of times smaller, something round."""
    wall = shapes.grid([0, 0, 0], [20, 0, 0], [0, 20, 0], 2)
    ball, faces, normals = shapes.sphere(16, 32, radius=0.002)
    vertices, triangles = shapes.join(wall, (ball, faces))
    return shapes.receiver(
        vertices, triangles, np.concatenate([np.tile([0, 0, 1.0], (9, 1)), normals])
    )


def scaled(factor, offset=0.0):
    vertices, triangles, normals = bumps(8)
    return shapes.receiver(vertices * factor + offset, triangles, normals)


def loose():
    rng = np.random.default_rng(1)
    vertices = rng.random((300, 1, 3)) * 5 + rng.random((300, 3, 3))
    return shapes.receiver(vertices.reshape(-1, 3), np.arange(900).reshape(-1, 3))


ODD = {
    "a triangle": lambda: shapes.receiver(np.eye(3), [[0, 1, 2]]),
    "a fan of 50 triangles at an edge": fan,
    "a Möbius strip": moebius,
    "two sides at the same place": doubled,
    "slivers": needles,
    "something small before something large": screws,
    "some triangles without area": partly_without_area,
    "a micrometre large": lambda: scaled(1e-6),
    "a thousand kilometres large": lambda: scaled(1e6),
    "far away": lambda: scaled(1.0, 1e4),
    "loose triangles": loose,
}


@pytest.mark.parametrize("make", ODD.values(), ids=ODD)
def test_odd_meshes_are_unwrapped(make):
    receiver = make()
    uvs = unwrapped(receiver, size=512).uvs[0]
    solid = ~are_needles(Surface.of(receiver).corners)
    sound = replace(
        receiver,
        triangles=receiver.triangles[solid],
        triangle_corners=receiver.triangle_corners[solid],
    )
    corners = places(sound, uvs)
    assert uvs.min() >= 0
    assert uvs.max() <= 1
    areas = Surface.of(sound).areas
    shown = shown_areas(corners) > 0
    assert areas[~shown].sum() <= 1e-6 * areas.sum()
    assert uv_map.problem(receiver, uvs) is None
    assert (shown_areas(places(receiver, uvs))[~solid] == 0).all()


def broken(vertices, triangles):
    return shapes.receiver(vertices, np.reshape(triangles, (-1, 3)), np.ones((len(vertices), 3)))


@pytest.mark.parametrize(
    ("receiver", "word"),
    [
        (broken(np.diag([1, 1, np.nan]), [[0, 1, 2]]), "NaN"),
        (broken(np.diag([1, 1, np.inf]), [[0, 1, 2]]), "infinite"),
        (broken(np.zeros((3, 3)), [[0, 1, 2]]), "without area"),
        (broken(np.arange(9.0).reshape(3, 3), [[0, 1, 2]]), "without area"),
        (broken(np.eye(3), []), "without area"),
    ],
)
def test_what_cannot_be_unwrapped_is_said_in_a_sentence(receiver, word):
    with pytest.raises(BakeError, match=word) as caught:
        unwrapped(receiver)
    assert receiver.name in str(caught.value)
    assert not str(caught.value).endswith(".")


def test_too_many_charts_for_the_atlas_are_refused():
    with pytest.raises(BakeError, match="no room for 300 charts"):
        unwrapped(loose(), size=64, padding=8)
    with pytest.raises(BakeError, match="larger than 16384"):
        unwrapped(loose(), size=0, density=1e5)
