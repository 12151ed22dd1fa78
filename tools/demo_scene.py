"""The demo's scene: Suzanne and friends on a finely meshed ground, under an HDRI of Blender's."""

import math
from collections.abc import Sequence
from pathlib import Path

import bpy
import numpy as np

GROUND = (0.5, 0.46, 0.4)
SHAPES = {  # name: (colour, place, turn about z in degrees, scale)
    "Suzanne": ((0.7, 0.22, 0.06), (0.0, 0.1, 0.99), 12, 1.0),
    "Torus": ((0.05, 0.2, 0.5), (1.95, -1.25, 0.283), 0, 0.7),
    "Ball": ((0.62, 0.5, 0.08), (-1.45, -1.5, 0.423), 0, 0.42),
    "Pawn": ((0.55, 0.55, 0.55), (-2.3, 0.6, 0.0), 0, 1.0),
    "Crate": ((0.16, 0.38, 0.14), (2.2, 1.2, 0.6), 27, 1.2),
}
PAWN = (  # radius and height of its profile
    (0.62, 0.0), (0.64, 0.1), (0.6, 0.22), (0.46, 0.3), (0.34, 0.5), (0.26, 0.9), (0.23, 1.3),
    (0.24, 1.42), (0.4, 1.5), (0.42, 1.56), (0.3, 1.62), (0.36, 1.72), (0.41, 1.9), (0.4, 2.05),
    (0.3, 2.22), (0.12, 2.31), (0.0, 2.32),
)  # fmt: skip


def build(hdri: Path, turn_degrees: float) -> bpy.types.Scene:
    """A new file with the demo's scene, its meshes selected."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    scene = bpy.context.scene
    ground = add_mesh("Ground", *_grid_plane(220, 14.0))
    ground.data.materials.append(_material("Ground", GROUND))
    for name, (colour, place, turn, scale) in SHAPES.items():
        shape = _shape(name)
        shape.name = name
        shape.location, shape.scale = place, (scale,) * 3
        shape.rotation_euler.z += math.radians(turn)
        shape.data.materials.append(_material(name, colour))
    bpy.ops.object.select_all(action="SELECT")
    add_world(scene, hdri, turn_degrees)
    _camera(scene)
    return scene


def bundled_hdri(name: str) -> Path:
    """One of the eight HDRIs that come with every Blender."""
    return Path(bpy.utils.system_resource("DATAFILES")) / "studiolights" / "world" / f"{name}.exr"


def _shape(name: str) -> bpy.types.Object:
    add = bpy.ops.mesh
    if name == "Suzanne":
        add.primitive_monkey_add(rotation=(math.radians(-8), 0, 0))
        _subdivide(3)
    elif name == "Torus":
        add.primitive_torus_add(
            major_segments=160, minor_segments=64, major_radius=1, minor_radius=0.4
        )
    elif name == "Ball":
        add.primitive_uv_sphere_add(segments=128, ring_count=64)
    elif name == "Pawn":
        return add_mesh(name, *_revolved(PAWN, 96, 6))
    else:
        add.primitive_cube_add(size=1)
        _refine(48)
        return bpy.context.object
    bpy.ops.object.shade_smooth()
    return bpy.context.object


def _revolved(
    profile: Sequence[tuple[float, float]], segments: int, steps: int
) -> tuple[np.ndarray, np.ndarray]:
    """A profile turned about z, each of its pieces cut into ``steps`` by a smooth curve."""
    points = np.array(profile)
    at = np.linspace(0, len(points) - 1, steps * (len(points) - 1) + 1)
    curve = np.stack([np.interp(at, np.arange(len(points)), points[:, k]) for k in (0, 1)], 1)
    for _ in range(2 * steps):
        curve[1:-1] = (curve[:-2] + 2 * curve[1:-1] + curve[2:]) / 4
    angle = np.linspace(0, 2 * np.pi, segments, endpoint=False)
    radius, height = curve.T[:, :, None]
    x, y = radius * np.cos(angle), radius * np.sin(angle)
    vertices = np.stack([x, y, height + 0 * x], -1)
    row, column = np.meshgrid(np.arange(len(curve) - 1), np.arange(segments), indexing="ij")
    a, b = row * segments + column, row * segments + (column + 1) % segments
    faces = np.stack([a, b, b + segments, a + segments], -1)
    return vertices.reshape(-1, 3), faces.reshape(-1, 4)


def _subdivide(levels: int) -> None:
    modifier = bpy.context.object.modifiers.new("Subdivision", "SUBSURF")
    modifier.levels = modifier.render_levels = levels


def _refine(cuts: int) -> None:
    """Cut long edges, so that the vertices are close enough to hold a shadow."""
    bpy.ops.object.mode_set(mode="EDIT")
    bpy.ops.mesh.select_all(action="SELECT")
    bpy.ops.mesh.subdivide(number_cuts=cuts)
    bpy.ops.object.mode_set(mode="OBJECT")


def _grid_plane(count: int, size: float) -> tuple[np.ndarray, np.ndarray]:
    steps = np.linspace(-size / 2, size / 2, count + 1)
    x, y = np.meshgrid(steps, steps, indexing="ij")
    vertices = np.stack([x, y, np.zeros_like(x)], -1).reshape(-1, 3)
    corner = (np.arange(count)[:, None] * (count + 1) + np.arange(count)).reshape(-1)
    faces = np.stack([corner, corner + count + 1, corner + count + 2, corner + 1], 1)
    return vertices, faces


def add_mesh(name: str, vertices: np.ndarray, faces: np.ndarray) -> bpy.types.Object:
    """A smooth mesh of vertices (V, 3) and faces in the scene."""
    mesh = bpy.data.meshes.new(name)
    mesh.from_pydata(vertices, [], faces.tolist(), shade_flat=False)
    obj = bpy.data.objects.new(name, mesh)
    bpy.context.collection.objects.link(obj)
    return obj


def _material(name: str, colour: tuple[float, float, float]) -> bpy.types.Material:
    """Principled without specular: what Cycles shows of it is diffuse light alone."""
    material = bpy.data.materials.new(name)
    if material.node_tree is None:
        material.use_nodes = True
    principled = next(n for n in material.node_tree.nodes if n.type == "BSDF_PRINCIPLED")
    principled.inputs["Base Color"].default_value = (*colour, 1)
    principled.inputs["Specular IOR Level"].default_value = 0
    return material


def add_world(scene: bpy.types.Scene, hdri: Path, turn_degrees: float) -> None:
    """Light ``scene`` by ``hdri``, turned about Z."""
    world = bpy.data.worlds.new("World")
    if world.node_tree is None:
        world.use_nodes = True
    tree = world.node_tree
    tree.nodes.clear()
    kinds = ("TexCoord", "Mapping", "TexEnvironment", "Background", "OutputWorld")
    nodes = [tree.nodes.new(f"ShaderNode{kind}") for kind in kinds]
    sockets = (
        ("Generated", "Vector"),
        ("Vector", "Vector"),
        ("Color", "Color"),
        ("Background", "Surface"),
    )
    for before, after, (out, into) in zip(nodes, nodes[1:], sockets, strict=False):
        tree.links.new(before.outputs[out], after.inputs[into])
    nodes[1].inputs["Rotation"].default_value = (0, 0, math.radians(turn_degrees))
    nodes[2].image = bpy.data.images.load(str(hdri))
    scene.world = world


def _camera(scene: bpy.types.Scene) -> None:
    camera = bpy.data.objects.new("Camera", bpy.data.cameras.new("Camera"))
    camera.location = (0.0, -8.2, 3.3)
    camera.rotation_euler = (math.radians(73), 0, 0)
    camera.data.lens = 48
    scene.collection.objects.link(camera)
    scene.camera = camera
