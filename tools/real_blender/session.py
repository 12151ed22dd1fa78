"""Runs inside a real Blender's window: builds a scene, says how things stand, does what it is told.

    blender --python session.py -- FOLDER

``FOLDER/state.json`` is rewritten a few times a second; a name of ``ACTIONS`` written to
``FOLDER/action`` is done once.  Clicks and keys come from outside, as an artist's do.
"""

import hashlib
import json
import math
import sys
from pathlib import Path

import bpy

FOLDER = Path(sys.argv[sys.argv.index("--") + 1])
PACKAGE = "bl_ext.user_default.prt_baker"
RAYS = 4096
done = []


def build():
    """Suzanne and a column on a finely meshed ground under one of Blender's maps."""
    bpy.ops.object.select_all(action="SELECT")
    bpy.ops.object.delete()
    bpy.ops.mesh.primitive_grid_add(x_subdivisions=160, y_subdivisions=160, size=8)
    paint("Ground", (0.5, 0.5, 0.5))
    bpy.ops.mesh.primitive_monkey_add(rotation=(-0.62, 0, 0.3))
    bpy.ops.object.shade_smooth()
    bpy.context.object.modifiers.new("Subdivision", "SUBSURF").levels = 2
    put_down(bpy.context.object)
    paint("Clay", (0.7, 0.3, 0.18))
    bpy.ops.mesh.primitive_cylinder_add(radius=0.3, depth=3, location=(-1.9, 0.9, 1.5))
    paint("Stone", (0.25, 0.4, 0.6))
    bpy.ops.object.select_all(action="DESELECT")
    light("forest")
    bpy.context.scene.prt.rays = RAYS


def put_down(obj):
    """Let ``obj`` touch the ground."""
    depsgraph = bpy.context.evaluated_depsgraph_get()
    mesh = obj.evaluated_get(depsgraph).data
    obj.location.z -= min((obj.matrix_world @ vertex.co).z for vertex in mesh.vertices)


def paint(name, colour):
    """Give the object just made a dull material of its own."""
    material = bpy.data.materials.new(name)
    material.use_nodes = True
    inputs = material.node_tree.nodes["Principled BSDF"].inputs
    inputs["Base Color"].default_value = (*colour, 1)
    inputs["Roughness"].default_value = 1
    bpy.context.object.data.materials.append(material)


def light(name):
    """Put a map of Blender's on the world, with a Mapping to turn it."""
    world = bpy.context.scene.world
    world.use_nodes = True
    nodes, links = world.node_tree.nodes, world.node_tree.links
    image, mapping, place = (
        nodes.new(f"ShaderNode{kind}") for kind in ("TexEnvironment", "Mapping", "TexCoord")
    )
    maps = Path(bpy.utils.system_resource("DATAFILES", path="studiolights/world"))
    image.image = bpy.data.images.load(str(maps / f"{name}.exr"))
    links.new(place.outputs["Generated"], mapping.inputs["Vector"])
    links.new(mapping.outputs["Vector"], image.inputs["Vector"])
    links.new(image.outputs["Color"], nodes["Background"].inputs["Color"])


def view():
    """The 3D view's area, its window region and its sidebar."""
    areas = bpy.context.window_manager.windows[0].screen.areas
    area = next(area for area in areas if area.type == "VIEW_3D")
    regions = {region.type: region for region in area.regions}
    return area, regions["WINDOW"], regions["UI"]


def show():
    """The scene from near, the sidebar open."""
    space = view()[0].spaces.active
    space.show_region_ui = True
    space.overlay.show_overlays = False
    space.show_gizmo = False
    space.region_3d.view_distance = 6.5
    space.region_3d.view_location = (0.6, 0, 0.7)


def render():
    """EEVEE in the viewport."""
    bpy.context.scene.eevee.taa_samples = 1
    view()[0].spaces.active.shading.type = "RENDERED"


def turn():
    """Turn the world by 90 degrees."""
    nodes = bpy.context.scene.world.node_tree.nodes
    nodes["Mapping"].inputs["Rotation"].default_value[2] += math.pi / 2


def reseed():
    """Let the next bake find nothing that is known already."""
    bpy.context.scene.prt.seed += 1


def save():
    """Write the scene, as it is, for a headless bake, and the same without a world."""
    bpy.ops.wm.save_as_mainfile(filepath=str(FOLDER / "scene.blend"), copy=True)
    world, bpy.context.scene.world = bpy.context.scene.world, None
    bpy.ops.wm.save_as_mainfile(filepath=str(FOLDER / "no world.blend"), copy=True)
    bpy.context.scene.world = world


def quit_blender():
    """Close without asking."""
    bpy.ops.wm.quit_blender()


ACTIONS = {
    "show": show,
    "render": render,
    "turn": turn,
    "reseed": reseed,
    "save": save,
    "quit": quit_blender,
}


def scene_hash():
    """Names everything that a bake may write."""
    digest = hashlib.sha256()
    for obj in sorted(bpy.data.objects, key=lambda obj: obj.name):
        digest.update(repr((obj.name, sorted(map(str, obj.items())))).encode())
        digest.update(repr([modifier.name for modifier in obj.modifiers]).encode())
    for mesh in sorted(bpy.data.meshes, key=lambda mesh: mesh.name):
        for attribute in mesh.attributes:
            digest.update(f"{mesh.name} {attribute.name}".encode())
            if attribute.data_type == "FLOAT_COLOR":
                values = bytearray(16 * len(attribute.data))
                attribute.data.foreach_get("color", memoryview(values).cast("f"))
                digest.update(values)
    for tree in [*bpy.data.node_groups, *(m.node_tree for m in bpy.data.materials if m.node_tree)]:
        digest.update(repr((tree.name, [node.name for node in tree.nodes])).encode())
    digest.update(repr(sorted(map(str, bpy.context.scene.items()))).encode())
    return digest.hexdigest()


def place(region):
    """Left, top, width, height on the screen, from the top left corner."""
    top = bpy.context.window_manager.windows[0].height - region.y - region.height
    return [region.x, top, region.width, region.height]


def state():
    """How things stand."""
    run = sys.modules[f"{PACKAGE}.addon.run_state"].current()
    _, window, sidebar = view()
    return {
        "done": done,
        "fraction": run.progress.fraction if run else None,
        "baked": [obj.name for obj in bpy.context.scene.objects if "prt_stamp" in obj],
        "scene": None if run else scene_hash(),
        "window": place(window),
        "sidebar": place(sidebar),
        "tab": sidebar.active_panel_category,
    }


def tick():
    """Do what is asked, say how things stand, come again."""
    asked = FOLDER / "action"
    if asked.exists():
        name = asked.read_text().strip()
        asked.unlink()
        ACTIONS[name]()
        done.append(name)
    text = json.dumps(state())
    (FOLDER / "state.new").write_text(text)
    (FOLDER / "state.new").rename(FOLDER / "state.json")
    return 0.25


bpy.context.preferences.view.show_splash = False
build()
bpy.app.timers.register(tick, first_interval=1, persistent=True)
