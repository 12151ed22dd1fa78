"""The share of a lobe that the nodes find is that of numpy."""

import numpy as np
import pytest
from bakes import principled, quad
from pictures import colour, look_down, pixel_centres, render
from prt_baker.addon import occlusion_nodes
from prt_baker.addon.prt.specular.occlusion import arriving, brightened, occlusion

ORDERS = (2, 3, 4, 5)
MIDDLE = np.array([0.5, 0.5, -0.4])  # of a square, which directions point away from


@pytest.fixture
def squares(scene):
    """A square for each order, which shows the share in grey: coefficients and factors of each."""
    look_down(scene, 5, 2)
    found = []
    for column, order in enumerate(ORDERS):
        rng = np.random.default_rng(order)
        seen = np.concatenate([[1.8], rng.normal(0, 0.5, order**2 - 1)])
        factors = np.sort(rng.uniform(0.2, 1, order))[::-1]
        factors[0] = 1
        material = principled()
        shown(material.node_tree, seen, factors, MIDDLE + np.array([1.2 * column, 0, 0]))
        quad(scene, 1.2 * column, 0, material)
        found.append((order, seen, factors))
    return found


def shown(tree, seen, factors, middle):
    """The share about the direction from ``middle`` to each place, as an emission."""
    tree, emission, away = away_from(tree, middle)
    share = occlusion_nodes.lobe(tree, numbers(tree, seen), away, numbers(tree, factors[1:]))
    tree.links.new(share, emission.inputs["Color"])


def away_from(tree, middle):
    """An empty ``tree`` that shows an emission; that, and the direction from ``middle``."""
    tree.nodes.clear()
    geometry, away, unit, emission, output = (
        tree.nodes.new(f"ShaderNode{kind}")
        for kind in ("NewGeometry", "VectorMath", "VectorMath", "Emission", "OutputMaterial")
    )
    away.operation, unit.operation = "SUBTRACT", "NORMALIZE"
    away.inputs[1].default_value = middle
    tree.links.new(geometry.outputs["Position"], away.inputs[0])
    tree.links.new(away.outputs[0], unit.inputs[0])
    tree.links.new(emission.outputs[0], output.inputs["Surface"])
    return tree, emission, unit.outputs[0]


def numbers(tree, values):
    sockets = []
    for value in values:
        node = tree.nodes.new("ShaderNodeValue")
        node.outputs[0].default_value = value
        sockets.append(node.outputs[0])
    return sockets


def colours(tree, values):
    sockets = []
    for value in values:
        node = tree.nodes.new("ShaderNodeCombineXYZ")
        for place, one in zip(node.inputs, value, strict=True):
            place.default_value = one
        sockets.append(node.outputs[0])
    return sockets


def directions_over(scene, column):
    """Pixels (H, W) of the square in ``column`` and the directions (P, 3) that they show."""
    centres = pixel_centres(scene)
    x, y = centres[..., 0] - 1.2 * column, centres[..., 1]
    inside = (np.minimum(x, y) > 0.05) & (np.maximum(x, y) < 0.95)
    places = np.stack([x, y, np.zeros_like(x)], axis=-1)[inside] - MIDDLE
    return inside, places / np.linalg.norm(places, axis=1, keepdims=True)


def test_eevee_finds_the_share_that_numpy_finds(scene, squares, tmp_path):
    picture = colour(render(scene, tmp_path), "Combined")
    for column, (order, seen, factors) in enumerate(squares):
        inside, directions = directions_over(scene, column)
        expected = occlusion(np.tile(seen, (len(directions), 1)), directions, factors)
        assert (expected < 1).any(), order
        assert (expected > 0).any(), order
        np.testing.assert_allclose(picture[inside], expected[:, None].repeat(3, 1), atol=1.5e-3)


@pytest.mark.parametrize("channels", [1, 3])
def test_eevee_finds_the_share_of_the_light_that_numpy_finds(scene, tmp_path, channels):
    look_down(scene, 5, 2)
    cases = []
    for column, order in enumerate(ORDERS):
        rng = np.random.default_rng(order)
        transfer = np.concatenate(
            [np.full((1, channels), 0.3), rng.normal(0, 0.1, (order**2 - 1, channels))]
        )
        light = np.concatenate([np.full((1, 3), 2.0), rng.normal(0, 0.7, (order**2 - 1, 3))])
        light = brightened(light, order)
        material = principled()
        tree, emission, away = away_from(
            material.node_tree, MIDDLE + np.array([1.2 * column, 0, 0])
        )
        sockets = numbers(tree, transfer[:, 0]) if channels == 1 else colours(tree, transfer)
        found = occlusion_nodes.arriving(tree, sockets, away)
        for i, (one, other) in enumerate(
            zip(light, light * occlusion_nodes.open_factors(order), strict=True)
        ):
            tree.nodes[f"M{i}"].inputs[1].default_value = one
            tree.nodes[f"O{i}"].inputs[1].default_value = other
        tree.links.new(found, emission.inputs["Color"])
        quad(scene, 1.2 * column, 0, material)
        cases.append((column, transfer.T[None], light))
    picture = colour(render(scene, tmp_path), "Combined")
    for column, transfer, light in cases:
        inside, directions = directions_over(scene, column)
        expected = arriving(transfer.repeat(len(directions), axis=0), directions, light)
        assert (expected < 1).any(), column
        np.testing.assert_allclose(picture[inside], expected, atol=1.5e-3)
