"""Our nodes in a material: a second output, for EEVEE, that shows the bake where there is one.

    Mix Shader(object's prt_baked; the artist's surface; its baked version) -> Material Output

They lie in one frame below the artist's nodes, which they only link to.
"""

from collections.abc import Callable, Iterator

import bpy

from . import nodes
from .material_plan import BAKED, SHADING, TAG, Feed, Part, Plan
from .prt.layout import Layout
from .reflection_nodes import FED, SWITCHES
from .stamp import SWITCH

FRAME = "PRT Bake"
Switches = dict[tuple[str, str], float]  # by the names of node and input
KINDS = {
    "mix": ("ShaderNodeMixShader", (0,), (1, 2)),
    "add": ("ShaderNodeAddShader", (), (0, 1)),
    "prt": ("ShaderNodeGroup", (0,), ()),
    "glossy": ("ShaderNodeGroup", range(len(FED)), ()),
    "emission": ("ShaderNodeEmission", (0, 1), ()),
    "transparent": ("ShaderNodeBsdfTransparent", (), ()),
}  # node type, inputs of its feeds, inputs of its parts


def build(
    tree: bpy.types.NodeTree,
    plan: Plan,
    layout: Layout,
    image: bpy.types.Image | None = None,
    reflected: bpy.types.Image | None = None,
) -> bpy.types.Node:
    """Add our nodes for ``plan``, which show bakes of ``layout``, on vertices or in ``image``, and
    reflect the light ``reflected``; returns the output, which is not active yet."""
    frame = tree.nodes.new("NodeFrame")
    frame.name = frame.label = FRAME
    frame.location = _free_corner(tree)
    switch = Part("mix", "", (Feed(),), (plan.own, plan.surface))

    def group(kind: str) -> bpy.types.NodeTree:
        return nodes.group(layout, image, reflected if kind == "glossy" else None)

    made = _nodes(tree, frame, switch, group)
    baked = _add(tree, frame, "ShaderNodeAttribute", -220, 220)
    baked.attribute_type, baked.attribute_name = "OBJECT", SWITCH
    tree.links.new(baked.outputs["Fac"], made[switch].inputs[0])
    output = _add(tree, frame, "ShaderNodeOutputMaterial", 220, 0)
    output.target = "EEVEE"
    tree.links.new(made[switch].outputs[0], output.inputs["Surface"])
    for identifier, feed in plan.others:
        place = next(s for s in output.inputs if s.identifier == identifier)
        tree.links.new(_socket(tree, feed), place)
    for node in (frame, *made.values(), baked, output):
        node[TAG] = SHADING
        node.select = False
    return output


def clear(tree: bpy.types.NodeTree, tag: str = SHADING) -> None:
    """Remove our nodes that are tagged ``tag``."""
    for node in [node for node in tree.nodes if node.get(TAG) == tag]:
        tree.nodes.remove(node)


def switches(tree: bpy.types.NodeTree) -> Switches:
    """What the artist set in our groups that no shader of his says."""
    return {
        (node.name, name): node.inputs[name].default_value
        for node in _reflecting(tree)
        for name in SWITCHES
    }


def set_switches(tree: bpy.types.NodeTree, kept: Switches) -> None:
    """Set what ``switches`` has found: of groups of another name what the first of them has."""
    firsts = {name: value for (_, name), value in reversed(kept.items())}
    for node in _reflecting(tree):
        for name, value in firsts.items():
            node.inputs[name].default_value = kept.get((node.name, name), value)


def _reflecting(tree: bpy.types.NodeTree) -> list[bpy.types.Node]:
    ours = [node for node in tree.nodes if node.get(TAG) == SHADING]
    return [node for node in ours if all(name in node.inputs for name in SWITCHES)]


def sync(tree: bpy.types.NodeTree, plan: Plan) -> bool:
    """Copy the values that the artist typed in since ``build``; True when one had changed."""
    changed = False
    for place, part in enumerate(_parts(plan.surface)):
        for index, feed in zip(KINDS[part.kind][1], part.feeds, strict=True):
            socket = tree.nodes[_name(place)].inputs[index]
            changed |= not feed.node and _set(socket, feed.value)
    return changed


def is_whole(tree: bpy.types.NodeTree, plan: Plan) -> bool:
    """Whether all that ``build`` made for ``plan`` is still there."""
    ours = [node for node in tree.nodes if node.get(TAG) == SHADING]
    parts = len(list(_parts(plan.surface)))
    names = {_name(place) for place in range(parts)}
    return len(ours) == parts + 4 and names <= {node.name for node in ours}


def _nodes(
    tree: bpy.types.NodeTree,
    frame: bpy.types.Node,
    switch: Part,
    group: Callable[[str], bpy.types.NodeTree],
) -> dict[Part, bpy.types.Node]:
    """A node for each part, linked; equal parts share one.  ``group`` gives what shows the bake in
    a part of a kind."""
    made: dict[Part, bpy.types.Node] = {}
    for place, part in enumerate((*_parts(switch.parts[1]), switch)):
        kind, feeds, parts = KINDS[part.kind]
        node = made[part] = _add(tree, frame, kind, -220 * _depth(switch, part), -180 * place)
        if part is switch:
            node.location = 0, 0
        else:
            node.name = _name(place)
        if part.kind in BAKED:
            node.node_tree = group(part.kind)
        for index, feed in zip(feeds, part.feeds, strict=True):
            _apply(tree, node.inputs[index], feed)
        for index, below in zip(parts, part.parts, strict=True):
            if below is not None:
                output = _socket(tree, below.feeds[0]) if below.kind == "own" else None
                tree.links.new(output or made[below].outputs[0], node.inputs[index])
    return made


def _parts(root: Part | None) -> Iterator[Part]:
    """The parts that take a node, each once, the ones below first."""
    seen: set[Part] = set()

    def walk(part: Part | None) -> Iterator[Part]:
        if part is None or part.kind == "own" or part in seen:
            return
        seen.add(part)
        for below in part.parts:
            yield from walk(below)
        yield part

    return walk(root)


def _depth(root: Part, part: Part) -> int:
    """How far ``part`` is from ``root``: its column."""
    if root is part or root == part:
        return 0
    below = [_depth(p, part) for p in root.parts if p is not None and p.kind != "own"]
    return 1 + min(below, default=99)


def _name(place: int) -> str:
    return f"PRT {place}"


def _apply(tree: bpy.types.NodeTree, socket: bpy.types.NodeSocket, feed: Feed) -> None:
    if feed.node:
        tree.links.new(_socket(tree, feed), socket)
    elif feed.value:
        _set(socket, feed.value)


def _set(socket: bpy.types.NodeSocket, value: tuple[float, ...]) -> bool:
    """Give ``socket`` the value; False when it already has it."""
    now = socket.default_value
    if hasattr(now, "__len__"):
        if tuple(now) == value:
            return False
        socket.default_value = value
    elif now == value[0]:
        return False
    else:
        socket.default_value = value[0]
    return True


def _socket(tree: bpy.types.NodeTree, feed: Feed) -> bpy.types.NodeSocket:
    outputs = tree.nodes[feed.node].outputs
    return next(socket for socket in outputs if socket.identifier == feed.socket)


def _add(
    tree: bpy.types.NodeTree, frame: bpy.types.Node, kind: str, x: float, y: float
) -> bpy.types.Node:
    node = tree.nodes.new(kind)
    node.parent = frame
    node.location = x, y
    return node


def _free_corner(tree: bpy.types.NodeTree) -> tuple[float, float]:
    """A place below the artist's nodes, under the rightmost."""
    places = [node.location for node in tree.nodes if node.parent is None]
    right = max((place.x for place in places), default=0)
    bottom = min((place.y for place in places), default=0)
    return right, bottom - 700
