"""Everything of a file that a bake touches, as plain values that can be compared."""

import bpy
from prt_baker.addon import attributes


def of(scene):
    """The state of ``scene`` and of all data."""
    return {
        "scene": _properties(scene),
        "objects": {obj.name: _object(obj) for obj in bpy.data.objects},
        "meshes": {mesh.name: _mesh(mesh) for mesh in bpy.data.meshes},
        "materials": {material.name: _material(material) for material in bpy.data.materials},
        "groups": sorted(tree.name for tree in bpy.data.node_groups),
    }


def _properties(owner):
    """Without the groups that Blender 4 keeps there, once they were looked at."""
    values = {key: owner[key] for key in owner.keys() if key not in {"cycles", "prt"}}  # noqa: SIM118
    return {k: str(v.to_dict() if hasattr(v, "to_dict") else v) for k, v in values.items()}


def _object(obj):
    return {
        "properties": _properties(obj),
        "modifiers": [(m.name, m.type, m.show_expanded) for m in obj.modifiers],
        "active": obj.modifiers.active and obj.modifiers.active.name,
        "slots": [(slot.link, slot.material) for slot in obj.material_slots],
        "scenes": [scene.name for scene in obj.users_scene],
    }


def _mesh(mesh):
    stored = mesh.attributes
    return {
        "properties": _properties(mesh),
        "attributes": sorted((a.name, a.domain, a.data_type, len(a.data)) for a in stored),
        "active": stored.active and stored.active.name,
        "colours": (stored.active_color_name, stored.default_color_name),
        "baked": {name: values.tolist() for name, (_, values) in attributes.take(mesh).items()},
        "materials": list(mesh.materials),
    }


def _material(material):
    tree = material.node_tree
    if tree is None or not _uses_nodes(material):
        return _properties(material), False
    return {
        "properties": _properties(material),
        "nodes": {node.name: _node(node) for node in tree.nodes},
        "active": tree.nodes.active and tree.nodes.active.name,
        "links": sorted(
            (x.from_node.name, x.from_socket.identifier, x.to_node.name, x.to_socket.identifier)
            for x in tree.links
        ),
    }


def _uses_nodes(material):
    return bpy.app.version >= (5, 0) or material.use_nodes


def _node(node):
    values = [getattr(socket, "default_value", None) for socket in node.inputs]
    return {
        "type": node.bl_idname,
        "place": tuple(node.location),
        "state": (node.select, node.mute, getattr(node, "is_active_output", None)),
        "values": [tuple(v) if hasattr(v, "__len__") else v for v in values],
        "properties": _properties(node),
    }
