"""The share of a lobe that the nodes find is that of numpy."""

import numpy as np
import pytest
from bakes import principled, quad
from pictures import colour, look_down, pixel_centres, render
from prt_baker.addon import occlusion_nodes
from prt_baker.addon.prt.specular.occlusion import occlusion

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
    tree.nodes.clear()
    geometry, away, unit, emission, output = (
        tree.nodes.new(f"ShaderNode{kind}")
        for kind in ("NewGeometry", "VectorMath", "VectorMath", "Emission", "OutputMaterial")
    )
    away.operation, unit.operation = "SUBTRACT", "NORMALIZE"
    away.inputs[1].default_value = middle
    tree.links.new(geometry.outputs["Position"], away.inputs[0])
    tree.links.new(away.outputs[0], unit.inputs[0])
    share = occlusion_nodes.share(
        tree, numbers(tree, seen), unit.outputs[0], numbers(tree, factors[1:])
    )
    tree.links.new(share, emission.inputs["Color"])
    tree.links.new(emission.outputs[0], output.inputs["Surface"])


def numbers(tree, values):
    sockets = []
    for value in values:
        node = tree.nodes.new("ShaderNodeValue")
        node.outputs[0].default_value = value
        sockets.append(node.outputs[0])
    return sockets


def test_eevee_finds_the_share_that_numpy_finds(scene, squares, tmp_path):
    picture = colour(render(scene, tmp_path), "Combined")
    centres = pixel_centres(scene)
    for column, (order, seen, factors) in enumerate(squares):
        x, y = centres[..., 0] - 1.2 * column, centres[..., 1]
        inside = (np.minimum(x, y) > 0.05) & (np.maximum(x, y) < 0.95)
        places = np.stack([x, y, np.zeros_like(x)], axis=-1)[inside] - MIDDLE
        directions = places / np.linalg.norm(places, axis=1, keepdims=True)
        expected = occlusion(np.tile(seen, (len(places), 1)), directions, factors)
        assert (expected < 1).any(), order
        assert (expected > 0).any(), order
        np.testing.assert_allclose(picture[inside], expected[:, None].repeat(3, 1), atol=1.5e-3)
