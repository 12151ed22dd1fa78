"""Spheres of all roughnesses side by side, each under the world alone: nothing reflects another."""

import math
from dataclasses import dataclass

import bpy
import numpy as np
import numpy.typing as npt
from mathutils import Vector
from picture_scenes import demo_scene, shapes
from prt_baker.addon.prt.specular.shading import Surface

Float = npt.NDArray[np.float64]
Index = npt.NDArray[np.int64]

ROUGHNESSES = (0.2, 0.4, 0.6, 0.8, 1.0)
GOLD, PAINT = (0.9, 0.6, 0.3), (0.5, 0.12, 0.08)
WHITE = (1.0, 1.0, 1.0)
RADIUS = 0.45
EDGE = 0.15  # the smallest cosine to the viewer that is compared: pixels of the silhouette are not
VIEW = np.array([0.0, -1.0, 0.0])  # towards the camera, which looks along +y


@dataclass(frozen=True)
class Sphere:
    """One at ``column`` and ``row``, from below, of ``surface``.  Where ``is_glossy`` Cycles shows
    a Glossy BSDF instead, GGX that scatters once and takes nothing of the light."""

    column: int
    row: int
    surface: Surface
    is_glossy: bool = False

    @property
    def name(self) -> str:
        """Says all that decides its picture."""
        kind = "glossy" if self.is_glossy else f"metallic {self.surface.metallic}"
        return f"{kind}, roughness {self.surface.roughness}, {self.surface.base}"


def spheres(*, with_glossy: bool) -> list[Sphere]:
    """A row of paint, one of gold above it, and one of what Cycles shows as a Glossy BSDF."""
    rows = [(0.0, PAINT, False), (1.0, GOLD, False), (1.0, WHITE, True)][: 2 + with_glossy]
    return [
        Sphere(column, row, Surface(base, metallic, roughness), is_glossy)
        for row, (metallic, base, is_glossy) in enumerate(rows)
        for column, roughness in enumerate(ROUGHNESSES)
    ]


def build(made: list[Sphere], hdri: str, turn_degrees: float, pixels: int) -> None:
    """A new file with the spheres, so many pixels apart, under one of Blender's HDRIs."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    vertices, triangles, normals = shapes.sphere(96, 192, RADIUS)
    for sphere in made:
        obj = demo_scene.add_mesh(sphere.name, vertices, triangles)
        obj.data.normals_split_custom_set_from_vertices(normals)
        obj.location = sphere.column + 0.5, 0, sphere.row + 0.5
        obj.visible_shadow = obj.visible_diffuse = obj.visible_glossy = False
        obj.data.materials.append(_material(sphere))
        obj.pass_index = 1
    scene = bpy.context.scene
    width = 1 + max(sphere.column for sphere in made)
    height = 1 + max(sphere.row for sphere in made)
    camera = bpy.data.objects.new("Camera", bpy.data.cameras.new("Camera"))
    camera.data.type, camera.data.ortho_scale = "ORTHO", max(width, height)
    camera.location, camera.rotation_euler = (width / 2, -10, height / 2), (math.pi / 2, 0, 0)
    scene.collection.objects.link(camera)
    scene.camera = camera
    scene.render.resolution_x, scene.render.resolution_y = pixels * width, pixels * height
    scene.render.resolution_percentage = 100
    scene.render.use_high_quality_normals = True  # else EEVEE has 10 bits of them, 0.6 % at r = 0.2
    demo_scene.add_world(scene, demo_scene.bundled_hdri(hdri), turn_degrees)


def seen(sphere: Sphere, step: int = 1) -> tuple[Index, Index, Float]:
    """The rows and columns (P,) of the picture's pixels that show ``sphere``, every ``step``th
    along both axes, and the unit normals there (P, 3)."""
    render, obj = bpy.context.scene.render, bpy.data.objects[sphere.name]
    scale = render.resolution_x / bpy.context.scene.camera.data.ortho_scale
    found = []
    for row in range(0, render.resolution_y, step):
        for column in range(0, render.resolution_x, step):
            x, z = (column + 0.5) / scale, (render.resolution_y - row - 0.5) / scale
            start = Vector((x, -10, z)) - obj.location
            hit, place, _, _ = obj.ray_cast(start, Vector((0, 1, 0)))
            # between vertices with normals away from the middle, so is the interpolated one
            if hit and place.normalized() @ Vector(VIEW) > EDGE:
                found.append((row, column, *place.normalized()))
    table = np.array(found)
    return *table[:, :2].astype(np.int64).T, table[:, 2:]


def _material(sphere: Sphere) -> bpy.types.Material:
    material = bpy.data.materials.new(sphere.name)
    if material.node_tree is None:
        material.use_nodes = True
    tree, surface = material.node_tree, sphere.surface
    principled = next(node for node in tree.nodes if node.type == "BSDF_PRINCIPLED")
    principled.inputs["Base Color"].default_value = (*surface.base, 1)
    principled.inputs["Metallic"].default_value = surface.metallic
    principled.inputs["Roughness"].default_value = surface.roughness
    if sphere.is_glossy:
        glossy, output = (
            tree.nodes.new(f"ShaderNode{kind}") for kind in ("BsdfAnisotropic", "OutputMaterial")
        )
        glossy.distribution = "GGX"
        glossy.inputs["Color"].default_value = (*surface.base, 1)
        glossy.inputs["Roughness"].default_value = surface.roughness
        output.target = "CYCLES"
        tree.links.new(glossy.outputs[0], output.inputs["Surface"])
    return material
