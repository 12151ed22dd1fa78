"""What the baked version of a material is made of, read from the artist's nodes.

A plan is plain data: it can be compared, so that an edit that only moves a value is told from one
that changes the tree.
"""

from dataclasses import dataclass, replace

import bpy

from .reflection_nodes import FED

TAG = "prt"  # custom property of our nodes in a material: SHADING or SURFACE
SHADING = "shading"  # shows the bake
BAKED = ("prt", "glossy")  # the kinds of parts that show a bake
SHINES = ("Metallic", "Specular IOR Level")  # where both are 0, nothing is reflected
SURFACE = "surface"  # stands in for the artist's, where there were no nodes


@dataclass(frozen=True)
class Feed:
    """What an input of ours shows: the output ``socket`` (identifier) of the artist's ``node``, or
    where that is "" a value that he typed in."""

    node: str = ""
    socket: str = ""
    value: tuple[float, ...] = ()


@dataclass(frozen=True)
class Part:
    """A shader: ``kind`` is "own", "mix", "add", "prt", "glossy" (that reflects), "emission" or
    "transparent"; ``source``
    names the artist's node that it stands for; ``feeds`` and ``parts`` go to its inputs."""

    kind: str
    source: str
    feeds: tuple[Feed, ...] = ()
    parts: tuple["Part | None", ...] = ()


@dataclass(frozen=True)
class Plan:
    """``own`` is the artist's surface, ``surface`` its baked version; None where he has none.
    ``others`` are the further inputs of his output, by identifier."""

    own: Part | None
    surface: Part | None
    others: tuple[tuple[str, Feed], ...]


def read(tree: bpy.types.NodeTree, preferred: str = "", *, reflects: bool = False) -> Plan:
    """The plan for a material's ``tree``; ``preferred`` names the output that was active before
    ours was.  Without ``reflects`` only diffuse light is baked."""
    output = artist_output(tree, preferred)
    if output is None:
        return Plan(None, None, ())
    surface = shader_origin(output.inputs["Surface"])
    others = tuple(
        (socket.identifier, _feed(socket))
        for socket in output.inputs
        if socket.identifier != "Surface" and _link(socket)
    )
    return Plan(_own(surface), _part(surface, frozenset(), reflects), others)


def artist_output(tree: bpy.types.NodeTree, preferred: str = "") -> bpy.types.Node | None:
    """The output that EEVEE would use without ours."""
    candidates = [
        node
        for node in tree.nodes
        if node.type == "OUTPUT_MATERIAL"
        and node.target in ("EEVEE", "ALL")
        and node.get(TAG) != SHADING
    ]

    def rank(node: bpy.types.Node) -> tuple[bool, bool, bool, bool]:
        stands_in = node.get(TAG) == SURFACE
        return stands_in, node.target == "EEVEE", node.name == preferred, node.is_active_output

    return max(candidates, key=rank, default=None)


def shader_origin(socket: bpy.types.NodeSocket) -> bpy.types.NodeSocket | None:
    """The output that feeds ``socket``, through reroutes and muted nodes; None where none does."""
    while (link := _link(socket)) is not None:
        node = link.from_node
        if node.type == "REROUTE":
            socket = node.inputs[0]
        elif node.mute:
            bypass = (b.from_socket for b in node.internal_links if b.to_socket == link.from_socket)
            through = next(bypass, None)
            if through is None:
                return None
            socket = through
        else:
            return link.from_socket
    return None


def without_values(part: Part | None) -> Part | None:
    """The part's structure: every typed-in value left out."""
    if part is None:
        return None
    feeds = tuple(replace(feed, value=()) for feed in part.feeds)
    return replace(part, feeds=feeds, parts=tuple(map(without_values, part.parts)))


def shows_bake(part: Part | None) -> bool:
    """Whether any closure of the material can show a bake."""
    return part is not None and (part.kind in BAKED or any(map(shows_bake, part.parts)))


def reflects(part: Part | None) -> bool:
    """Whether any closure of the material reflects."""
    return part is not None and (part.kind == "glossy" or any(map(reflects, part.parts)))


def _link(socket: bpy.types.NodeSocket) -> bpy.types.NodeLink | None:
    links = socket.links
    return links[0] if links and not links[0].is_muted else None


def _feed(socket: bpy.types.NodeSocket) -> Feed:
    link = _link(socket)
    if link is not None:
        return Feed(link.from_node.name, link.from_socket.identifier)
    value = socket.default_value
    return Feed(value=tuple(value) if hasattr(value, "__len__") else (value,))


def _own(socket: bpy.types.NodeSocket | None) -> Part | None:
    if socket is None:
        return None
    return Part("own", socket.node.name, (Feed(socket.node.name, socket.identifier),))


def _part(
    socket: bpy.types.NodeSocket | None, above: frozenset[str], reflects: bool
) -> Part | None:
    """The baked version of a shader; ``above`` holds the nodes on the way here, against cycles."""
    if socket is None or socket.node.name in above:
        return _own(socket)
    node, above = socket.node, above | {socket.node.name}
    if node.type in ("MIX_SHADER", "ADD_SHADER"):
        shaders = [s for s in node.inputs if s.type == "SHADER"]
        parts = tuple(_part(shader_origin(s), above, reflects) for s in shaders)
        feeds = (_feed(node.inputs[0]),) if node.type == "MIX_SHADER" else ()
        return Part("mix" if feeds else "add", node.name, feeds, parts)
    if node.type == "BSDF_DIFFUSE":
        return Part("prt", node.name, (_feed(node.inputs["Color"]),))
    if node.type == "BSDF_PRINCIPLED":
        return _principled(node, _own(socket), reflects)
    return _own(socket)


def _principled(node: bpy.types.Node, own: Part | None, reflects: bool) -> Part:
    """Its diffuse light from the bake, with its emission and alpha, and where it ``reflects`` its
    reflections; as much of it as transmits, or else is metal, stays the artist's."""
    name, inputs = node.name, node.inputs
    shown = Part("prt", name, (_feed(inputs["Base Color"]),))
    glossy = reflects and not all(_constant(inputs[one], 0) for one in SHINES)
    if glossy:
        shown = Part("glossy", name, tuple(_feed(inputs[one]) for one in FED))
    if not _constant(inputs["Emission Strength"], 0):
        feeds = _feed(inputs["Emission Color"]), _feed(inputs["Emission Strength"])
        shown = Part("add", name, (), (shown, Part("emission", name, feeds)))
    if not _constant(inputs["Alpha"], 1):
        shown = Part("mix", name, (_feed(inputs["Alpha"]),), (Part("transparent", name), shown))
    for kept in ("Metallic", "Transmission Weight"):
        if not _constant(inputs[kept], 0) and not (glossy and kept == "Metallic"):
            shown = Part("mix", name, (_feed(inputs[kept]),), (shown, own))
    return shown


def _constant(socket: bpy.types.NodeSocket, value: float) -> bool:
    return _link(socket) is None and socket.default_value == value
