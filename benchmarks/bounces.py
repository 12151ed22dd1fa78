"""Colour bleeding in EEVEE against Cycles' (diffuse light, as many bounces, the world's full HDRI).

A box with a red and a green wall, open to the front and the top, a ball and a block in it.  Prints
a table in Markdown: the relative RMS of the pixels that show a mesh, without Cycles' noise, with
the residual and without it.  ``--image`` writes the picture of the documentation.
"""

import argparse
import math
import os
import sys
import tempfile
from pathlib import Path

import bpy
import numpy as np
import picture_bakes
import picture_files
import picture_scenes
import picture_truth
from picture_scenes import demo_scene, shapes
from picture_truth import Picture
from prt_baker.addon.prt.job import Settings

CACHE = picture_scenes.ROOT / ".cache" / "bench" / "pictures"
HDRIS = ("courtyard", "sunset")
SIZE = 320
RESOLUTION = 512  # texels a side
CELLS = 40  # along a side of a wall
WHITE, RED, GREEN = (0.8, 0.8, 0.8), (0.75, 0.08, 0.06), (0.1, 0.5, 0.08)


def box() -> None:
    """A new file with the box, white but for its walls, and a camera that looks into it."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    walls = {
        "Floor": (shapes.grid([-1, -1, -1], [2, 0, 0], [0, 2, 0], CELLS), WHITE),
        "Back": (shapes.grid([-1, 1, -1], [2, 0, 0], [0, 0, 2], CELLS), WHITE),
        "Left": (shapes.grid([-1, -1, -1], [0, 2, 0], [0, 0, 2], CELLS), RED),
        "Right": (shapes.grid([1, -1, -1], [0, 0, 2], [0, 2, 0], CELLS), GREEN),
    }
    corner, faces = shapes.box(0.6, 16, inward=False)
    turn = np.array([[math.cos(0.4), -math.sin(0.4), 0], [math.sin(0.4), math.cos(0.4), 0]])
    block = np.stack([*(corner @ turn.T).T, corner[:, 2]], axis=1) + np.array([-0.4, 0.25, -0.7])
    ball, sides, _ = shapes.sphere(48, 96, 0.33)
    walls |= {
        "Block": ((block, faces), WHITE),
        "Ball": ((ball + np.array([0.42, -0.2, -0.67]), sides), WHITE),
    }
    for number, (name, (mesh, colour)) in enumerate(walls.items(), 1):
        obj = demo_scene.add_mesh(name, *mesh)
        obj.pass_index = number
        obj.data.materials.clear()
        obj.data.materials.append(_matte(name, colour))
        for polygon in obj.data.polygons:
            polygon.use_smooth = name == "Ball"
    camera = bpy.data.objects.new("Camera", bpy.data.cameras.new("Camera"))
    camera.location, camera.rotation_euler = (0, -5.2, 0.1), (math.radians(88), 0, 0)
    camera.data.lens = 68
    scene = bpy.context.scene
    scene.collection.objects.link(camera)
    scene.camera = camera
    scene.render.resolution_x = scene.render.resolution_y = SIZE
    scene.render.resolution_percentage = 100
    demo_scene.add_world(scene, demo_scene.bundled_hdri(HDRIS[0]), 0.0)


def _matte(name: str, colour: tuple[float, float, float]) -> bpy.types.Material:
    """A Diffuse BSDF."""
    material = bpy.data.materials.new(name)
    if material.node_tree is None:
        material.use_nodes = True
    tree = material.node_tree
    tree.nodes.clear()
    output, diffuse = (
        tree.nodes.new(f"ShaderNode{kind}") for kind in ("OutputMaterial", "BsdfDiffuse")
    )
    diffuse.inputs["Color"].default_value = (*colour, 1)
    tree.links.new(diffuse.outputs[0], output.inputs["Surface"])
    return material


def main() -> None:
    """The table, and the picture."""
    asked = _arguments()
    with tempfile.TemporaryDirectory() as temporary, picture_bakes.add_on():
        folder = Path(temporary)
        box()
        covered = picture_truth.objects(folder) > 0
        print("| HDRI | bounces | baked to | with residual, % | without, % | Cycles' noise, % |")
        print("|---" * 6 + "|")
        for hdri in asked.hdri:
            for bounces in asked.bounces:
                picture_scenes.show_world(hdri, asked.turn)
                truth = picture_truth.truth(CACHE, bounces)
                for carrier in asked.carrier:
                    shown = [_shown(bounces, on, carrier, folder) for on in (False, True)]
                    errors = [picture_truth.relative_error(s, truth, covered) for s in shown]
                    figures = (*reversed(errors), truth.noise(covered))
                    cells = " | ".join(f"{100 * figure:.1f}" for figure in figures)
                    print(f"| {hdri} | {bounces} | {carrier} | {cells} |", flush=True)
                    if asked.image and hdri == asked.hdri[0] and bounces == max(asked.bounces):
                        picture_files.compare(asked.image, shown[1], truth, covered)
    sys.stdout.flush()
    os._exit(0)  # Blender may crash in its own clean-up at exit


def _shown(bounces: int, residual: bool, carrier: str, folder: Path) -> Picture:
    """What EEVEE shows of a bake."""
    settings = Settings(bounces=bounces, residual=residual, resolution=RESOLUTION)
    picture_bakes.bake_all(settings, carrier)
    picture = picture_bakes.picture(folder)
    picture_bakes.remove_all()
    return picture


def _arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--hdri", nargs="+", default=HDRIS)
    parser.add_argument("--bounces", nargs="+", type=int, default=[0, 1, 3])
    parser.add_argument("--carrier", nargs="+", default=["vertex", "texture"])
    parser.add_argument("--turn", type=float, default=0.0, help="of the world, in degrees")
    parser.add_argument("--image", type=Path, help="the picture: EEVEE, Cycles, their difference")
    return parser.parse_args()


if __name__ == "__main__":
    main()
