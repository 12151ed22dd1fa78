"""The scenes of the pictures: a torus knot over floor and wall, and the demo, both white."""

import math
import sys
from pathlib import Path

import bpy
import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1] / "tools"))
sys.path.insert(0, str(Path(__file__).parents[1] / "tests" / "engine"))
import demo_scene
import shapes

ROOT = Path(__file__).parents[1]
HDRIS = ("city", "courtyard", "forest", "interior", "night", "studio", "sunrise", "sunset")
WIDTH, HEIGHT = 320, 180
DEPTH, REACH, HIGH = 1.9, 5.0, 3.0  # where the wall stands, the floor's side, the wall's height
CELLS = 200  # along a side of the floor


def knot() -> None:
    """A new file with the knot of 600 x 24 vertices, its floor and wall, and a camera."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    vertices, triangles, _ = shapes.torus_knot(600, 24)
    left, cell = -REACH / 2, REACH / CELLS
    floor = shapes.grid([left, DEPTH - REACH, -1], [REACH, 0, 0], [0, REACH, 0], CELLS)
    wall = _wall([left, DEPTH, -1], CELLS, round(HIGH / cell), cell)
    for name, mesh in (("Knot", (vertices, triangles)), ("Floor", floor), ("Wall", wall)):
        demo_scene.add_mesh(name, *mesh)
    camera = bpy.data.objects.new("Camera", bpy.data.cameras.new("Camera"))
    camera.location = (0.9, -6.2, 2.1)
    camera.rotation_euler = (math.radians(71), 0, math.radians(8))
    camera.data.lens = 46
    bpy.context.collection.objects.link(camera)
    bpy.context.scene.camera = camera
    _finish()


def demo() -> None:
    """The demo's scene."""
    demo_scene.build(demo_scene.bundled_hdri("sunset"), TURN["demo"])
    _finish()


SCENES = {"knot": knot, "demo": demo}
TURN = {"knot": 0.0, "demo": 60.0}  # of the world, in degrees


def show_world(hdri: str, turn_degrees: float) -> None:
    """Let the open scene's world be ``hdri`` of Blender's, turned about Z; our light follows."""
    nodes = bpy.context.scene.world.node_tree.nodes
    texture = next(n for n in nodes if n.type == "TEX_ENVIRONMENT")
    path = str(demo_scene.bundled_hdri(hdri))
    if bpy.path.abspath(texture.image.filepath) != path:
        texture.image = bpy.data.images.load(path, check_existing=True)
    mapping = next(n for n in nodes if n.type == "MAPPING")
    mapping.inputs["Rotation"].default_value = (0, 0, math.radians(turn_degrees))
    bpy.context.view_layer.update()


def meshes() -> list[bpy.types.Object]:
    """What is baked."""
    return [obj for obj in bpy.context.scene.objects if obj.type == "MESH"]


def _wall(
    origin: list[float], columns: int, rows: int, cell: float
) -> tuple[np.ndarray, np.ndarray]:
    """A wall of square cells that faces -y."""
    x, z = np.meshgrid(np.arange(columns + 1), np.arange(rows + 1), indexing="ij")
    vertices = np.array(origin) + cell * np.stack([x, 0 * x, z], -1).reshape(-1, 3)
    corner = (np.arange(columns)[:, None] * (rows + 1) + np.arange(rows)).reshape(-1)
    faces = np.stack([corner, corner + rows + 1, corner + rows + 2, corner + 1], 1)
    return vertices, faces


def _finish() -> None:
    """One white material for everything, a number for every mesh, a small picture."""
    white = bpy.data.materials.new("White")
    if white.node_tree is None:
        white.use_nodes = True
    principled = next(n for n in white.node_tree.nodes if n.type == "BSDF_PRINCIPLED")
    principled.inputs["Base Color"].default_value = (1, 1, 1, 1)
    principled.inputs["Specular IOR Level"].default_value = 0
    for number, obj in enumerate(meshes(), 1):
        obj.pass_index = number
        obj.data.materials.clear()
        obj.data.materials.append(white)
    scene = bpy.context.scene
    if scene.world is None:
        demo_scene.add_world(scene, demo_scene.bundled_hdri("sunset"), 0.0)
    scene.render.resolution_x, scene.render.resolution_y = WIDTH, HEIGHT
    scene.render.resolution_percentage = 100
