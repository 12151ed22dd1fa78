"""A surface for what has no shader nodes, so that it can show a bake.

Before 5.0, Cycles shows such materials, and faces without any, as diffuse, and EEVEE and the glTF
exporter as a Principled BSDF.  From 5.0 on there are only faces without any, Principled everywhere.
"""

import bpy

from .material_plan import SURFACE, TAG

NAME = "PRT Default"
PRINCIPLED = ("ALL", "ShaderNodeBsdfPrincipled")
DIFFUSE = ("CYCLES", "ShaderNodeBsdfDiffuse")
GREY = (0.8, 0.8, 0.8, 1.0)  # Blender's surface of a face without a material


def material() -> bpy.types.Material:
    """The material for faces that have none, one for the whole file."""
    found = next((m for m in bpy.data.materials if m.get(NAME)), None)
    if found is not None:
        return found
    made = bpy.data.materials.new(NAME)
    made[NAME] = True
    if not has_nodes(made):
        made.use_nodes = True
    made.node_tree.nodes.clear()
    _build(made.node_tree, GREY, metallic=0.0, roughness=0.5, tag="")
    return made


def is_ours(material: bpy.types.Material) -> bool:
    """Whether it is the material for faces that have none."""
    return bool(material.get(NAME))


def free_unused() -> None:
    """Delete the default material where no object has it."""
    for found in [m for m in bpy.data.materials if m.get(NAME) and not m.users]:
        bpy.data.materials.remove(found)


def has_nodes(material: bpy.types.Material) -> bool:
    """Whether the material's nodes are used; since 5.0 they always are."""
    return bpy.app.version >= (5, 0) or bool(material.use_nodes)


def give(material: bpy.types.Material) -> None:
    """Make nodes that look like ``material`` does without; ``take`` undoes it."""
    material.use_nodes = True
    colour = (*material.diffuse_color[:3], 1.0)
    _build(material.node_tree, colour, material.metallic, material.roughness, SURFACE)


def take(material: bpy.types.Material) -> None:
    """Back to a material without nodes; ours are gone already."""
    material.use_nodes = False


def _build(
    tree: bpy.types.NodeTree,
    colour: tuple[float, ...],
    metallic: float,
    roughness: float,
    tag: str,
) -> None:
    rgb = tree.nodes.new("ShaderNodeRGB")
    rgb.outputs[0].default_value = colour
    shaders = [PRINCIPLED] if bpy.app.version >= (5, 0) else [PRINCIPLED, DIFFUSE]
    made = [rgb]
    for row, (target, kind) in enumerate(shaders):
        shader, output = tree.nodes.new(kind), tree.nodes.new("ShaderNodeOutputMaterial")
        shader.location, output.location = (200, -450 * row), (500, -450 * row)
        output.target = target
        tree.links.new(rgb.outputs[0], shader.inputs[0])
        tree.links.new(shader.outputs[0], output.inputs["Surface"])
        made += [shader, output]
    principled, output = made[1], made[2]
    principled.inputs["Metallic"].default_value = metallic
    principled.inputs["Roughness"].default_value = roughness
    output.is_active_output = True
    for node in made:
        node.select = False
        if tag:
            node[TAG] = tag
