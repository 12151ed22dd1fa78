"""Installs a zip, bakes with it and disables it; prints what it saw as one line of JSON.

BLENDER_USER_RESOURCES=FOLDER python installed_bake.py prt_baker-linux_x64.zip
"""

import importlib.util
import json
import sys
import tempfile
from pathlib import Path

import bpy

ID = "bl_ext.user_default.prt_baker"
HANDLERS = ("depsgraph_update_post", "frame_change_post", "load_post", "undo_post", "redo_post")


def hdri():
    """One of the maps that Blender brings."""
    maps = Path(bpy.utils.resource_path("LOCAL")) / "datafiles/studiolights/world"
    return str(next(maps.glob("*.exr")))


def light_scene():
    """A cube over a ground, under a map, all selected."""
    bpy.ops.mesh.primitive_plane_add(size=4, location=(0, 0, -1))
    bpy.ops.mesh.primitive_cube_add()
    bpy.ops.object.select_all(action="SELECT")
    world = bpy.data.worlds.new("World")
    world.use_nodes = True
    image = world.node_tree.nodes.new("ShaderNodeTexEnvironment")
    image.image = bpy.data.images.load(hdri())
    background = next(n for n in world.node_tree.nodes if n.type == "BACKGROUND")
    world.node_tree.links.new(image.outputs["Color"], background.inputs["Color"])
    bpy.context.scene.world = world


def files(folder):
    """Every file below ``folder`` but Python's own caches."""
    return {str(p) for p in folder.rglob("*") if p.is_file() and "__pycache__" not in p.parts}


def ours(handlers):
    """The handlers of the extension."""
    return [f.__name__ for f in handlers if f.__module__.startswith(ID)]


def bake():
    """Bake and describe."""
    result = bpy.ops.prt.bake()
    return {
        "result": sorted(result),
        "attributes": [a.name for a in bpy.context.object.data.attributes if a.name[:5] == "_PRT_"],
        "light": "prt_light" in bpy.context.scene,
        "engine_left": [p.name for p in Path(tempfile.gettempdir()).glob("prt-job-*")],
        "native": [
            importlib.util.find_spec(name).origin for name in ("embreex", "xatlas", "OpenEXR")
        ],
    }


def disable():
    """Switch the extension off and look for what it left."""
    bpy.ops.preferences.addon_disable(module=ID)
    left = [name for name in ("bake", "cancel", "verify") if hasattr(bpy.types, f"PRT_OT_{name}")]
    return {
        "operators": left,
        "settings": hasattr(bpy.types.Scene, "prt"),
        "handlers": [name for kind in HANDLERS for name in ours(getattr(bpy.app.handlers, kind))],
    }


def main():
    """Do it all."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    bpy.ops.extensions.package_install_files(
        repo="user_default", filepath=sys.argv[1], enable_on_install=True
    )
    folder = Path(sys.modules[ID].__file__).parent
    before = files(folder)
    light_scene()
    said = bake()
    said["new_files"] = sorted(files(folder) - before)
    said["after"] = disable()
    print(json.dumps(said))


main()
