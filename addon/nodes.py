"""The node group *PRT Shading*: what is baked times the light that it holds.

One group for each layout and atlas in use, and one light for all of them; materials that reflect
have one with more inputs (``reflection_nodes``).  Input: Base Color.  Outputs: Shader, an emission,
and Exit Radiance, its colour (W sr⁻¹ m⁻², base colour included, never negative).  The light's
numbers are the values of nodes: ``L i`` its coefficients, ``R k`` the weights of the residuals,
``S j`` the lights cut out and ``P i`` what they take from the transfer.  The object's ``prt_exact``
says how much of all but the ``L i`` it shows.
"""

import json
from collections.abc import Iterator
from dataclasses import asdict, dataclass

import bpy
import numpy as np

from . import light_state, node_values, reflection_nodes, reflections, stamp
from .light_state import LightState
from .prt.layout import Layout

NAME = "PRT Shading"
TAG = "prt_layout"
ATLAS = "prt_image"  # the image that a group reads, where it reads one
REFLECTED = reflection_nodes.IMAGE
Socket = bpy.types.NodeSocket
Named = list[tuple[str, Socket]]


def group(
    layout: Layout,
    image: bpy.types.Image | None = None,
    reflected: bpy.types.Image | None = None,
) -> bpy.types.NodeTree:
    """The group that shades bakes of ``layout`` on vertices, or in ``image``, and reflects the
    light ``reflected``; made where there is none yet."""
    look = image, reflected, reflected is not None
    alike = (t for t in groups() if (t.get(ATLAS), t.get(REFLECTED), REFLECTED in t) == look)
    found = next((tree for tree in alike if layout_of(tree) == layout), None)
    return found or _build(layout, image, reflected)


def groups() -> list[bpy.types.NodeTree]:
    """Every PRT Shading group of the file."""
    return [tree for tree in bpy.data.node_groups if TAG in tree]


def layout_of(tree: bpy.types.NodeTree) -> Layout:
    """The layout of the attributes or tiles that the group reads."""
    return Layout.of(json.loads(tree[TAG]))


def set_light(light: LightState) -> bool:
    """Light every group; True when something changed."""
    changed = [_light(tree, light) for tree in groups()]
    return any(changed)


def reflect(reflected: bpy.types.Image) -> None:
    """Let every group that reflects do so with another image, under the light that it has."""
    for tree in groups():
        before = tree.get(REFLECTED)
        if REFLECTED not in tree or before == reflected:
            continue
        tree[REFLECTED] = reflected
        known = reflections.of(reflected)
        if before is not None and reflections.of(before).is_read_like(known):
            for node in tree.nodes:
                if node.type == "TEX_IMAGE" and node.image == before:
                    node.image = reflected
            continue
        named = [node for node in tree.nodes if node.label]
        kept = [(node.name, reflection_nodes.held(node)) for node in named]
        tree.nodes.clear()
        _fill(tree, layout_of(tree), tree.get(ATLAS), reflected)
        for name, value in kept:
            if name in tree.nodes:
                tree.nodes[name].inputs[1].default_value = value


def free_unused() -> None:
    """Delete the groups that no material has; the first that is left has the plain name."""
    for tree in [tree for tree in groups() if not tree.users]:
        bpy.data.node_groups.remove(tree)
    if groups() and NAME not in bpy.data.node_groups:
        groups()[0].name = NAME


def _light(tree: bpy.types.NodeTree, light: LightState) -> bool:
    changed = False
    named = [*_values(layout_of(tree), light)]
    if tree.get(REFLECTED) is not None:
        named += reflection_nodes.values(light, tree, layout_of(tree))
    for name, value in named:
        socket = tree.nodes[name].inputs[1]
        if not np.array_equal(socket.default_value, value):
            socket.default_value = value if value.ndim else float(value)
            changed = True
    return changed


def _values(layout: Layout, light: LightState) -> Iterator[tuple[str, np.ndarray]]:
    """What each node of a group of ``layout`` holds, (3,) float32."""
    terms = light_state.terms(light, layout)
    lights = np.zeros((layout.lights, 3))  # all, where the present ones are fewer
    lights[: len(terms.lights)] = terms.lights
    count = layout.order**2
    rows = {"L": light.radiance_sh[:count], "R": terms.residual, "S": lights}
    if layout.lights:
        rows["P"] = -terms.cut_out[:count]
    for letter, values in rows.items():
        for i, value in enumerate(np.asarray(values, np.float32)):
            yield f"{letter}{i}", value


def _build(
    layout: Layout, image: bpy.types.Image | None, reflected: bpy.types.Image | None
) -> bpy.types.NodeTree:
    name = f"{NAME} ({layout})" if NAME in bpy.data.node_groups else NAME
    tree = bpy.data.node_groups.new(name, "ShaderNodeTree")
    tree[TAG] = json.dumps(asdict(layout))
    if image is not None:
        tree[ATLAS] = image
    _interface(tree)
    if reflected is not None:
        tree[REFLECTED] = reflected
        reflection_nodes.interface(tree)
    _fill(tree, layout, image, reflected)
    return tree


def _fill(
    tree: bpy.types.NodeTree,
    layout: Layout,
    image: bpy.types.Image | None,
    reflected: bpy.types.Image | None,
) -> None:
    """All nodes of a group."""
    stored = _stored(tree, layout, image)
    white = _clamped(tree, stored.total, layout.order**2)
    inside = _node(tree, "NodeGroupInput", 180 * layout.order**2, 200)
    if reflected is None:
        albedo = _node(tree, "ShaderNodeVectorMath", 180 * layout.order**2 + 180, 0)
        albedo.operation = "MULTIPLY"
        tree.links.new(white, albedo.inputs[0])
        tree.links.new(inside.outputs["Base Color"], albedo.inputs[1])
        shown = albedo.outputs[0]
    else:
        inputs = {socket.name: socket for socket in inside.outputs}
        light = reflection_nodes.Reflected(
            reflected, stored.shadows, stored.share, stored.seen, stored.transfer
        )
        shown = reflection_nodes.exit_radiance(tree, inputs, white, light)
    _show(tree, shown, layout.order**2)


@dataclass(frozen=True)
class _Stored:
    """What comes of the floats of a bake: ``total``, the exit radiance of a white surface, not
    clamped yet; ``shadows``, the visibilities of the lights cut out, and what ``share`` of these
    belongs to the light, None without; ``seen``, the visibility's coefficients; and those of the
    ``transfer``."""

    total: Socket
    shadows: list[Socket]
    share: Socket | None
    seen: list[Socket]
    transfer: list[Socket]


def _stored(tree: bpy.types.NodeTree, layout: Layout, image: bpy.types.Image | None) -> _Stored:
    floats = iter(node_values.floats(tree, layout, image))
    width, rows = (1 if layout.channels == 1 else 3), iter(range(100))

    def stored(letter: str, count: int, width: int) -> Named:
        return [
            (f"{letter}{i}", _joined(tree, [next(floats) for _ in range(width)], next(rows)))
            for i in range(count)
        ]

    transfer = stored("T", layout.order**2, width)
    residuals, visibilities = stored("R", layout.turns, 3), stored("S", layout.lights, 1)
    total = _weighted_sum(tree, [(f"L{name[1:]}", socket) for name, socket in transfer], 0)
    share = None
    if residuals or visibilities:
        exact = _node(tree, "ShaderNodeAttribute", -300, 400)
        exact.attribute_type, exact.attribute_name = "OBJECT", stamp.EXACT
        share = exact.outputs["Fac"]
    if residuals:
        total = _plus(tree, _weighted_sum(tree, residuals, 1), share, total)
    if visibilities:
        taken = [(f"P{name[1:]}", socket) for name, socket in transfer]
        lamps = _weighted_sum(tree, visibilities + taken, 2)
        share = _whether(tree, share)
        total = _plus(tree, lamps, share, total)
    shadows, coefficients = ([socket for _, socket in one] for one in (visibilities, transfer))
    return _Stored(total, shadows, share, list(floats), coefficients)


def _interface(tree: bpy.types.NodeTree) -> None:
    face = tree.interface
    colour = face.new_socket("Base Color", in_out="INPUT", socket_type="NodeSocketColor")
    colour.default_value = (1, 1, 1, 1)
    face.new_socket("Shader", in_out="OUTPUT", socket_type="NodeSocketShader")
    face.new_socket("Exit Radiance", in_out="OUTPUT", socket_type="NodeSocketColor")


def _joined(tree: bpy.types.NodeTree, floats: list[Socket], row: int) -> Socket:
    """One float as it is, three as a colour."""
    if len(floats) == 1:
        return floats[0]
    combine = _node(tree, "ShaderNodeCombineXYZ", -300, -150 * row)
    for socket, place in zip(floats, combine.inputs, strict=True):
        tree.links.new(socket, place)
    return combine.outputs[0]


def _weighted_sum(tree: bpy.types.NodeTree, factors: Named, row: int) -> Socket:
    """The sum of the factors times what the nodes of their names hold."""
    total = None
    for i, (name, factor) in enumerate(factors):
        term = _multiply_add(tree, -100 + 180 * i, -60 * i - 900 * row)
        term.name = term.label = name
        tree.links.new(factor, term.inputs[0])
        if total is not None:
            tree.links.new(total, term.inputs[2])
        total = term.outputs[0]
    return total


def _plus(tree: bpy.types.NodeTree, term: Socket, share: Socket, total: Socket) -> Socket:
    """``total`` and its ``share`` of ``term``."""
    node = _multiply_add(tree, 180, 400)
    for place, socket in zip(node.inputs, (term, share, total), strict=False):
        tree.links.new(socket, place)
    return node.outputs[0]


def _whether(tree: bpy.types.NodeTree, share: Socket) -> Socket:
    """1 where there is any ``share``."""
    node = _node(tree, "ShaderNodeMath", 0, 400)
    node.operation = "GREATER_THAN"
    node.inputs[1].default_value = 0
    tree.links.new(share, node.inputs[0])
    return node.outputs[0]


def _multiply_add(tree: bpy.types.NodeTree, x: float, y: float) -> bpy.types.Node:
    node = _node(tree, "ShaderNodeVectorMath", x, y)
    node.operation = "MULTIPLY_ADD"
    node.inputs[1].default_value = node.inputs[2].default_value = (0, 0, 0)
    return node


def _clamped(tree: bpy.types.NodeTree, total: Socket, column: int) -> Socket:
    """Never below 0."""
    clamp = _node(tree, "ShaderNodeVectorMath", 180 * column, 0)
    clamp.operation = "MAXIMUM"
    tree.links.new(total, clamp.inputs[0])
    return clamp.outputs[0]


def _show(tree: bpy.types.NodeTree, shown: Socket, column: int) -> None:
    """As an emission."""
    emission = _node(tree, "ShaderNodeEmission", 180 * column + 360, 0)
    outside = _node(tree, "NodeGroupOutput", 180 * column + 540, 0)
    tree.links.new(shown, emission.inputs["Color"])
    tree.links.new(emission.outputs[0], outside.inputs["Shader"])
    tree.links.new(shown, outside.inputs["Exit Radiance"])


def _node(tree: bpy.types.NodeTree, kind: str, x: float, y: float) -> bpy.types.Node:
    node = tree.nodes.new(kind)
    node.location = (x, y)
    return node
