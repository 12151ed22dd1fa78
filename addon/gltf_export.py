"""Write the scene as a .glb, through Blender's own exporter."""

import io
import json
import re
import struct
import sys
from collections.abc import Iterator
from contextlib import contextmanager, redirect_stderr
from pathlib import Path
from typing import Any

import bpy

from . import outputs
from .gltf import shown_bakes
from .prt.errors import BakeError

PACKAGE = __package__.rpartition(".")[0]


def write(path: str, object_names: list[str] | None = None) -> None:
    """Export the visible objects of the scene to the .glb ``path``, at the current frame.

    The bakes of ``object_names``, by default of all baked objects that are visible, are in it, or
    BakeError or RuntimeError says why not; then there is no file, or the one that was there before.
    """
    target = Path(path)
    if target.suffix.lower() != ".glb":
        raise BakeError(f"The glTF file {path} must be called .glb")
    expected = _visible_bakes() if object_names is None else _named_bakes(object_names)
    outputs.check([target])
    with outputs.staged([target]) as places:
        _export(places[target])
        _check_bakes(places[target], expected)


def _visible_bakes() -> set[str]:
    """Names of the objects that will come out with a bake."""
    return {obj.name for obj in shown_bakes() if obj.visible_get() and _in_scene(obj)}


def _in_scene(obj: bpy.types.Object) -> bool:
    """Whether ``obj`` and its parents are in the scene: the exporter loses orphans."""
    if bpy.context.scene.objects.get(obj.name) is not obj:
        return False
    return obj.parent is None or _in_scene(obj.parent)


def _named_bakes(names: list[str]) -> set[str]:
    """``names``, when all of them will come out with a bake."""
    missing = sorted(set(names) - _visible_bakes())
    if missing:
        raise BakeError(
            f"{missing[0]!r} is hidden, not baked, or its parent is not in the scene, so the .glb "
            "would not show its bake"
        )
    return set(names)


def _export(path: Path) -> None:
    if not hasattr(bpy.types, "EXPORT_SCENE_OT_gltf"):
        raise BakeError("Enable the add-on glTF 2.0 format in the preferences to write a .glb")
    said = io.StringIO()
    try:
        with _found_by_the_exporter(), redirect_stderr(said):  # Blender prints a traceback there
            bpy.ops.export_scene.gltf(
                filepath=str(path),
                export_format="GLB",
                use_visible=True,
                use_active_scene=True,
                export_current_frame=True,
            )
    except RuntimeError as error:
        reason = re.search(r"\[Errno \d+\] ([^:\n]+)", str(error))
        if reason is None:
            raise
        raise BakeError(f"{path} cannot be written: {reason[1]}") from error
    print(said.getvalue(), end="", file=sys.stderr)


@contextmanager
def _found_by_the_exporter() -> Iterator[None]:
    """The exporter asks the add-ons that stand in the preferences, and a package from pip does not
    stand there: enter it while the file is written."""
    addons = bpy.context.preferences.addons
    if PACKAGE in addons:
        yield
        return
    entry = addons.new()
    entry.module = PACKAGE
    try:
        yield
    finally:
        addons.remove(entry)


def _check_bakes(glb: Path, expected: set[str]) -> None:
    """RuntimeError when an object's bake is not in the file: the exporter only logs what fails."""
    document = _json(glb)
    meshes = document.get("meshes", [])
    found = {
        node.get("name")
        for node in document.get("nodes", [])
        if "mesh" in node and "prt" in meshes[node["mesh"]].get("extras", {})
    }
    if expected - found:
        raise RuntimeError(f"The bake of {sorted(expected - found)} did not reach the .glb")


def _json(glb: Path) -> dict[str, Any]:
    """The first chunk of a .glb."""
    with glb.open("rb") as file:
        length = struct.unpack("<12xI4x", file.read(20))[0]
        document: dict[str, Any] = json.loads(file.read(length))
    return document
