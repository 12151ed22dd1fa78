"""A bake without an artist: what the command line does once its options are understood."""

import difflib
import json
import sys
from collections.abc import Callable, Generator
from contextlib import AbstractContextManager, closing, nullcontext
from dataclasses import replace
from itertools import takewhile
from pathlib import Path
from typing import Any

import bpy

from . import bake, figures, gltf, gltf_export, gltf_panel, outputs, properties, scene, selection
from .atlas_files import Target
from .options import Options
from .progress_lines import ProgressLines
from .prt.errors import BakeError
from .prt.job import Progress, Settings

Report = dict[str, Any]
SETTINGS = (
    "order",
    "rays",
    "tolerance",
    "residual",
    "turns",
    "peaks",
    "final_light",
    "bounces",
    "keep_direct",
    "reflections",
    "visibility_order",
    "seed",
    "threads",
    "resolution",
    "texel_density",
    "shared_atlas",
    "half",
    "engine_images",
)


def open_blend(path: Path) -> None:
    """Open ``path``; BakeError when it is damaged."""
    try:
        bpy.ops.wm.open_mainfile(filepath=str(path.absolute()), load_ui=False)
    except RuntimeError as error:
        raise BakeError(f"{path} cannot be opened: {_reason(error)}") from error


def check_opened(command_line: list[str]) -> None:
    """BakeError when Blender could not open the .blend of its ``command_line``: it goes on with
    its startup scene, and that would be baked."""
    given = takewhile(lambda word: word not in {"-c", "--command"}, command_line)
    blends = [word for word in given if Path(word).suffix.lower() == ".blend"]
    if blends and not bpy.data.filepath:
        raise BakeError(f"{blends[-1]} cannot be opened: see what Blender says above")


def run(asked: Options, check: Callable[[], None]) -> None:
    """Bake the opened scene, write what was asked for, and print a line for each object.

    ``check`` is called at every step, and raises when the work was interrupted.
    """
    with _in_a_window():
        _run(asked, check)


def _in_a_window() -> AbstractContextManager[None]:
    """Blender's ``--command`` has no window in its context, and so no active object: the glTF
    exporter asks for it."""
    windows = bpy.context.window_manager.windows
    if bpy.context.window or not windows:
        return nullcontext()
    return bpy.context.temp_override(window=windows[0])


def _run(asked: Options, check: Callable[[], None]) -> None:
    current = bpy.context.scene
    names = _object_names(current, asked.objects)
    settings = _settings(current, asked)
    world = str(Path(asked.world).absolute()) if asked.world else None
    if not asked.outputs:
        sys.stderr.write("Nothing will be written: --save, --gltf and --report do\n")
    if asked.keep_direct and not settings.bounces:
        sys.stderr.write("Nothing bounces, so all light is direct: --bounces says how often\n")
    target = _target(current, asked)
    report = _finish(bake.bake(current.name, names, settings, world, target), check)
    sys.stderr.writelines(f"{note}\n" for note in report["notes"])
    report["lamps_left_out"] = _lamps(current)
    with outputs.staged(asked.outputs) as places:
        _write(asked, places, names, report)
        check()
    for name in names:
        for stamp in selection.stamps([name]):
            lines = [*figures.stamp_lines(stamp), *filter(None, [figures.advice(stamp)])]
            sys.stdout.write(f"{name}: {', '.join(lines)}\n")


def _target(current: bpy.types.Scene, asked: Options) -> Target:
    """Where the bake goes: textures lie beside the .blend that is saved, and in it where none is
    and no folder is named."""
    chosen = properties.target(current)
    carrier, folder, stem = asked.carrier or chosen.carrier, asked.images, chosen.stem
    if asked.save is not None:
        folder, stem = folder or asked.save.parent, asked.save.stem
    return Target(carrier, None if asked.pack else folder and folder.absolute(), stem)


def _lamps(current: bpy.types.Scene) -> list[str]:
    """The lamps of the scene: they light its render, and no bake."""
    names = [obj.name for obj in current.objects if obj.type == "LIGHT" and not obj.hide_render]
    if names:
        sys.stderr.write(f"Lamps are not in the bake: {', '.join(names)}\n")
    return names


def _object_names(current: bpy.types.Scene, asked: list[str]) -> list[str]:
    """The objects to bake, each once, in the order asked for."""
    if not asked:
        return [obj.name for obj in scene.default_objects(bpy.context)]
    for name in asked:
        if name not in current.objects:
            near = difflib.get_close_matches(name, current.objects.keys(), n=3)
            hint = f": did you mean {' or '.join(map(repr, near))}?" if near else ""
            raise BakeError(f"Scene {current.name!r} has no object {name!r}{hint}")
    return list(dict.fromkeys(asked))


def _settings(current: bpy.types.Scene, asked: Options) -> Settings:
    """The artist's settings in the .blend, with what the options say instead."""
    given = {name: getattr(asked, name) for name in SETTINGS}
    chosen = {name: value for name, value in given.items() if value is not None}
    if "rays" in chosen:
        chosen["tolerance"] = 0.0
    if "resolution" in chosen:
        chosen["texel_density"] = 0.0
    if "turns" in chosen:
        chosen["residual"] = True
    if not asked.cache:
        chosen["cache"] = ""
    return replace(properties.settings(current, asked.verify), **chosen)


def _finish(steps: Generator[Progress, None, Report], check: Callable[[], None]) -> Report:
    """Run ``steps`` to their end, showing how far they are; their report."""
    lines = ProgressLines(sys.stderr)
    with closing(steps), closing(lines):
        while True:
            check()
            try:
                lines.show(next(steps))
            except StopIteration as end:
                return end.value


def _write(asked: Options, places: dict[Path, Path], names: list[str], report: Report) -> None:
    if asked.save:
        _save(asked.save, places[asked.save])
    if asked.gltf:
        wanted = (asked.gltf_short, asked.gltf_error, asked.gltf_ibl)
        with gltf_panel.chosen(bpy.context.scene, *wanted):
            gltf_export.write(str(places[asked.gltf]), names)
        report["gltf"] = list(gltf.REPORT)
    if asked.report:
        text = json.dumps(report, indent=2, ensure_ascii=False)
        places[asked.report].write_text(f"{text}\n", encoding="utf-8")


def _save(path: Path, place: Path) -> None:
    """Write the scene to ``place``, whose folder is that of ``path``: relative paths hold."""
    try:
        bpy.ops.wm.save_as_mainfile(filepath=str(place), copy=True, relative_remap=True)
    except RuntimeError as error:
        # Blender's own reason is a wrong one when the disk is full
        raise BakeError(f"{path} cannot be written whole: make room in its folder") from error


def _reason(error: RuntimeError) -> str:
    """What Blender's operator says, as the end of a sentence."""
    return str(error).strip().splitlines()[-1].removeprefix("Error: ").rstrip(".")
