"""Names what a material's nodes are, so that what was made of them can be kept."""

import hashlib
from collections.abc import Iterable
from typing import Any

import bpy
import numpy as np

from .prt.digests import add_array, add_files

PLAIN = (bool, int, float, str)
NOT_LOOK = {"location", "location_absolute", "width", "height", "select", "label", "hide", "color"}


def of(material: bpy.types.Material | None) -> bytes:
    """A hash of all that decides the look of ``material``."""
    digest = hashlib.blake2b(digest_size=20)
    if material is not None:
        _add(digest, "", tuple(material.diffuse_color))
        if material.node_tree is not None:
            _add_tree(digest, material.node_tree)
    return digest.digest()


def of_nodes(nodes: Iterable[bpy.types.Node]) -> bytes:
    """A hash of all that decides what ``nodes`` do together, but the pixels of their pictures: it
    takes no time, so it can be asked for at every change."""
    digest = hashlib.blake2b(digest_size=20)
    for node in sorted(nodes, key=lambda node: (node.id_data.name, node.name)):
        _add_node(digest, node, with_pixels=False)
        for socket in node.inputs:
            ends = [(link.from_node.name, link.from_socket.identifier) for link in socket.links]
            _add(digest, "links", ends)
    return digest.digest()


def _add(digest: "hashlib.blake2b", name: str, value: Any) -> None:
    digest.update(f"{name}={value!r};".encode())


def _add_tree(digest: "hashlib.blake2b", tree: bpy.types.NodeTree) -> None:
    for node in tree.nodes:
        _add_node(digest, node, with_pixels=True)
        if getattr(node, "node_tree", None):
            _add_tree(digest, node.node_tree)
    for link in tree.links:
        ends = (link.from_node, link.from_socket, link.to_node, link.to_socket)
        _add(digest, "link", [getattr(e, "identifier", e.name) for e in ends] + [link.is_muted])


def _add_node(digest: "hashlib.blake2b", node: bpy.types.Node, *, with_pixels: bool) -> None:
    """``node`` and the values of its sockets."""
    _add(digest, node.name, node.bl_idname)
    _add_properties(digest, node, with_pixels=with_pixels)
    for socket in (*node.inputs, *node.outputs):
        value = getattr(socket, "default_value", None)
        plain = value is None or isinstance(value, PLAIN)
        _add(digest, socket.identifier, value if plain else tuple(value))


def _add_properties(digest: "hashlib.blake2b", node: bpy.types.Node, *, with_pixels: bool) -> None:
    """What is set in the node itself: choices, ramps, curves and pictures."""
    for prop in node.bl_rna.properties:
        if prop.identifier in NOT_LOOK:
            continue
        value = getattr(node, prop.identifier, None)
        if isinstance(value, PLAIN):
            _add(digest, prop.identifier, value)
        elif isinstance(value, bpy.types.ColorRamp):
            stops = [(e.position, tuple(e.color)) for e in value.elements]
            _add(digest, prop.identifier, (value.interpolation, value.color_mode, stops))
        elif isinstance(value, bpy.types.CurveMapping):
            curves = [[tuple(p.location) for p in curve.points] for curve in value.curves]
            _add(digest, prop.identifier, curves)
        elif isinstance(value, bpy.types.Image):
            if with_pixels:
                _add_image(digest, value)
            else:
                _add(digest, value.name, (value.filepath, value.colorspace_settings.name))


def _add_image(digest: "hashlib.blake2b", image: bpy.types.Image) -> None:
    """Its file; or, where there is none or it was painted on, its pixels."""
    _add(digest, image.name, (image.source, image.colorspace_settings.name, tuple(image.size)))
    if image.source == "FILE" and not image.is_dirty and not image.packed_file:
        add_files(digest, bpy.path.abspath(image.filepath, library=image.library))
    elif image.packed_file and not image.is_dirty:
        digest.update(image.packed_file.data)
    elif image.has_data:
        values = np.empty(len(image.pixels), np.float32)
        image.pixels.foreach_get(values)
        add_array(digest, "pixels", values)
