"""Cycles, as far as Blender's users can take it: transfer as bakes of diffuse light.

The transfer's coefficient i is what a white surface shows under the world Y_i.  A world cannot be
negative, so each function is baked as its positive and its negative part, to a float colour
attribute of the vertices.  The world is only met by rays that the surface sends (no sampling of its
map), which suits such smooth lights best: with multiple importance the error at equal rays is no
lower and every bake prepares a map first.  No bounces, no clamping, no adaptive samples.
"""

import contextlib
import os
import time
from collections.abc import Iterator
from importlib.metadata import version
from typing import Any

import numpy as np
from peers import BakedMesh, Traced, World
from prt_baker.addon.prt import sh

ORDER = 3
WIDTH = 512
ATTRIBUTE = "bake"

state: dict[str, Any] = {}


def versions() -> dict[str, str]:
    """Of what it is made of."""
    return {"bpy": version("bpy")}


def prepare(world: World) -> float:
    """A scene for bakes, with a bake behind it; 0 s, since every bake builds what it needs."""
    import bpy

    mesh = world.baked
    assert mesh is not None
    bpy.ops.wm.read_factory_settings(use_empty=True)
    scene = bpy.context.scene
    set_up(scene, world.threads)
    add("others", mesh.other_vertices, mesh.other_triangles)
    baked = add("baked", mesh.vertices, mesh.triangles, mesh.normals)
    baked.data.materials.append(white())
    colors = baked.data.attributes.new(ATTRIBUTE, "FLOAT_COLOR", "POINT")
    baked.data.color_attributes.active_color = colors
    baked.select_set(True)
    bpy.context.view_layer.objects.active = baked
    state.update(mesh=mesh, baked=baked, texture=add_world(scene), worlds=half_worlds())
    trace("", 1, 0)
    return 0.0


def trace(_method: str, rays: int, seed: int) -> Traced:
    """Transfer of every vertex, with ``rays`` samples in every bake."""
    import bpy

    mesh: BakedMesh = state["mesh"]
    settings = bpy.context.scene.cycles
    settings.samples, settings.seed = rays, seed
    transfer = np.zeros((len(mesh.vertices), ORDER**2), np.float32)
    start = time.perf_counter()
    for i, sign, image in state["worlds"]:
        state["texture"].image = image
        transfer[:, i] += sign * bake()
    seconds = time.perf_counter() - start
    at_points = np.empty_like(transfer)
    at_points[mesh.vertex_points] = transfer
    return Traced(seconds, at_points)


def bake() -> np.ndarray:
    """What every vertex (V,) shows under the world as it is."""
    import bpy

    with silence():
        bpy.ops.object.bake(type="DIFFUSE", pass_filter={"DIRECT"}, target="VERTEX_COLORS")
    colors = state["baked"].data.attributes[ATTRIBUTE].data
    values = np.empty((len(colors), 4), np.float32)
    colors.foreach_get("color", values.reshape(-1))
    return values[:, 0]


@contextlib.contextmanager
def silence() -> Iterator[None]:
    """Without what Blender prints for every bake."""
    kept = os.dup(1)
    with open(os.devnull, "wb") as nothing:  # noqa: PTH123 - a device
        os.dup2(nothing.fileno(), 1)
    try:
        yield
    finally:
        os.dup2(kept, 1)
        os.close(kept)


def set_up(scene: Any, threads: int) -> None:
    """Cycles on the processor; everything off that would bend the values."""
    scene.render.engine = "CYCLES"
    scene.render.threads_mode, scene.render.threads = "FIXED", threads
    cycles = scene.cycles
    cycles.device = "CPU"
    cycles.use_adaptive_sampling = False
    cycles.max_bounces = 0
    cycles.sample_clamp_direct = cycles.sample_clamp_indirect = 0


def add(
    name: str, vertices: np.ndarray, triangles: np.ndarray, normals: np.ndarray | None = None
) -> Any:
    """A mesh in the scene, smooth where it has vertex ``normals``."""
    import bpy

    mesh = bpy.data.meshes.new(name)
    mesh.from_pydata(vertices.tolist(), [], triangles.tolist(), shade_flat=normals is None)
    if normals is not None:
        mesh.normals_split_custom_set_from_vertices(normals)
    thing = bpy.data.objects.new(name, mesh)
    bpy.context.collection.objects.link(thing)
    return thing


def white() -> Any:
    """A white diffuse material."""
    import bpy

    material = bpy.data.materials.new("white")
    tree = tree_of(material)
    diffuse, output = (
        tree.nodes.new(kind) for kind in ("ShaderNodeBsdfDiffuse", "ShaderNodeOutputMaterial")
    )
    diffuse.inputs["Color"].default_value = (1, 1, 1, 1)
    tree.links.new(diffuse.outputs[0], output.inputs[0])
    return material


def add_world(scene: Any) -> Any:
    """A world that shows a picture; the picture's node."""
    import bpy

    scene.world = bpy.data.worlds.new("basis")
    scene.world.cycles.sampling_method = "NONE"
    tree = tree_of(scene.world)
    texture, background, output = (
        tree.nodes.new(f"ShaderNode{kind}")
        for kind in ("TexEnvironment", "Background", "OutputWorld")
    )
    tree.links.new(texture.outputs[0], background.inputs[0])
    tree.links.new(background.outputs[0], output.inputs[0])
    return texture


def tree_of(block: Any) -> Any:
    """The empty node tree of a material or world."""
    import bpy

    if bpy.app.version < (5, 0):
        block.use_nodes = True
    block.node_tree.nodes.clear()
    return block.node_tree


def half_worlds() -> list[tuple[int, int, Any]]:
    """(i, sign, picture) of each part of a basis function that is not 0 everywhere."""
    import bpy

    u, v = (np.arange(WIDTH) + 0.5) / WIDTH, (np.arange(WIDTH // 2) + 0.5) / (WIDTH // 2)
    azimuth, height = (0.5 - u) * 2 * np.pi, (v[:, None] - 0.5) * np.pi
    flat = np.cos(height)
    sides = flat * np.cos(azimuth), flat * np.sin(azimuth), np.sin(height) + 0 * azimuth
    values = sh.basis(np.stack(sides, axis=-1), ORDER)
    parts = []
    for i in range(ORDER**2):
        for sign in (1, -1):
            part = np.maximum(sign * values[..., i], 0)
            if not part.any():
                continue
            image = bpy.data.images.new(f"{sign * i}", WIDTH, WIDTH // 2, float_buffer=True)
            image.colorspace_settings.name = "Non-Color"
            pixels = np.repeat(part[..., None], 4, axis=-1).astype(np.float32)
            image.pixels.foreach_set(pixels.reshape(-1))
            parts.append((i, sign, image))
    return parts
