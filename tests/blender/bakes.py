"""Made-up bakes, to be written without an engine."""

from dataclasses import replace

import bpy
import numpy as np
from prt_baker.addon import carrier, stamp, writeback
from prt_baker.addon import scene as scenes
from prt_baker.addon.prt.results import ReceiverResult


def quad(scene, x=0.0, y=0.0, material=None, name="Quad"):
    """A unit square facing up, its corner at (x, y)."""
    mesh = bpy.data.meshes.new(name)
    mesh.from_pydata([(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0)], [], [(0, 1, 2, 3)])
    if material is not None:
        mesh.materials.append(material)
    return place(scene, mesh, x, y)


def place(scene, mesh, x, y):
    """An object of ``mesh`` at (x, y)."""
    obj = bpy.data.objects.new(mesh.name, mesh)
    obj.location = x, y, 0
    scene.collection.objects.link(obj)
    bpy.context.view_layer.update()
    return obj


def principled(name="Material", **values):
    """A material with a Principled BSDF; ``Base_Color=...`` sets its inputs."""
    material = bpy.data.materials.new(name)
    if bpy.app.version < (5, 0):
        material.use_nodes = True
    for key, value in values.items():
        shader(material).inputs[key.replace("_", " ")].default_value = value
    return material


def shader(material):
    """The Principled BSDF of ``material``."""
    return next(n for n in material.node_tree.nodes if n.type == "BSDF_PRINCIPLED")


def add(material, kind, **inputs):
    """A new node, ``ShaderNode`` and ``kind``, with values for its inputs."""
    node = material.node_tree.nodes.new(f"ShaderNode{kind}")
    for name, value in inputs.items():
        node.inputs[name].default_value = value
    return node


def output_of(material):
    """The artist's output."""
    return next(n for n in material.node_tree.nodes if n.type == "OUTPUT_MATERIAL")


def link(material, source, target):
    """Join two sockets."""
    material.node_tree.links.new(source, target)


def full(count):
    """A material that reads ``count`` attributes of its own, which are all black."""
    material = principled("Full")
    total = None
    for k in range(count):
        attribute, term = add(material, "Attribute"), add(material, "VectorMath")
        attribute.attribute_name = f"Own {k}"
        term.operation = "ADD"
        term.inputs[1].default_value = (0.5, 0.5, 0.5)
        link(material, attribute.outputs["Color"], term.inputs[0])
        if total is not None:
            link(material, total, term.inputs[1])
        total = term.outputs[0]
    link(material, total, shader(material).inputs["Base Color"])
    return material


def random_bake(obj, layout, domain="POINT", seed=0):
    """A bake of random values for every vertex or corner of ``obj``."""
    depsgraph = bpy.context.evaluated_depsgraph_get()
    with carrier.evaluated_mesh(obj, depsgraph) as mesh:
        count = len(mesh.vertices if domain == "POINT" else mesh.loops)
    rng = np.random.default_rng(seed)
    transfer = rng.normal(0, 0.3, (count, layout.channels, layout.order**2))
    transfer[:, :, 0] = rng.uniform(0.8, 1.2, (count, layout.channels))
    result = ReceiverResult(
        obj.name,
        transfer.astype(np.float32),
        np.arange(count, dtype=np.int32),
        rng.normal(0, 0.1, (count, layout.turns, 3)).astype(np.float32),
        rng.uniform(0, 1, (count, layout.lights)).astype(np.float32),
        visibility_sh=rng.normal(0, 1, (count, layout.visibility_order**2)).astype(np.float32),
    )
    return obj, result, stamp_for(obj, layout, domain)


def constant_bake(obj, layout):
    """A bake of the constant light only: exit radiance is the light's first coefficient."""
    obj, result, stamp = random_bake(obj, layout)
    result.transfer[:] = 0
    result.transfer[:, :, 0] = 1
    result.residual[:] = result.visibility[:] = 0
    return obj, result, stamp


def stamp_for(obj, layout, domain):
    by_modifier = carrier.needs_modifier(obj, bpy.context.evaluated_depsgraph_get())
    made = stamp.blank(obj, layout, domain, by_modifier, scenes.mesh_signature(obj))
    return replace(made, points=len(obj.data.vertices))


def write(scene, layout, *objects, domain="POINT"):
    """Bake ``objects`` at random; returns what was written."""
    baked = [random_bake(o, layout, domain, seed) for seed, o in enumerate(objects)]
    writeback.write(scene, baked, layout)
    return baked
