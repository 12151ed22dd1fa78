"""Bake, verify and light update from beginning to end, as generators of progress.

Nothing of the scene changes before the whole result is there, and closing a generator leaves the
scene as it was.  Between two steps only names are kept: an undo kills pointers.
"""

from collections.abc import Generator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import bpy

from . import (
    attributes,
    carrier,
    engine,
    light_state,
    live_light,
    scene,
    stamp,
    world,
    world_file,
    writeback,
)
from .prt import job as jobs
from .prt.errors import BakeError
from .prt.layout import Layout
from .prt.light import world_sh
from .world import WorldLight

Report = dict[str, Any]
Steps = Generator[jobs.Progress, None, Report]


def bake(
    scene_name: str,
    object_names: Sequence[str],
    settings: jobs.Settings,
    hdri: str | None = None,
) -> Steps:
    """Bake the objects and light them; the report is the generator's value, with what the artist
    should know in ``notes``, one sentence each.

    ``hdri`` names an image that becomes the scene's world with the result; a cubemap, which no
    world can show, only lights the bake.
    """
    with engine.job_folder() as folder:
        layout = Layout(settings.order)
        objects = _objects(object_names)
        scene.check_objects(objects)
        writeback.check(bpy.data.scenes[scene_name], objects, layout)
        notes = writeback.notes(bpy.data.scenes[scene_name], objects)
        yield jobs.Progress("scene", 0.0)
        job, light = _read(scene_name, object_names, settings, hdri, folder)
        stamps = [
            _stamp(obj, layout, receiver.domain)
            for obj, receiver in zip(_objects(object_names), job.receivers, strict=True)
        ]
        results = yield from engine.run(job, folder)
    is_cubemap = results.report["light"]["projection"] == "cubemap"
    if hdri is None or is_cubemap:
        light = replace(light, follows=light.follows and not is_cubemap)
        _write(scene_name, results, stamps, layout)
    else:
        with world_file.made(hdri) as its_world:
            _write(scene_name, results, stamps, layout)
        bpy.data.scenes[scene_name].world = its_world
    _set_light(scene_name, light, results.image_sh, baked=True)
    return {**results.report, "notes": notes}


def verify(object_names: Sequence[str], settings: jobs.Settings) -> Steps:
    """Trace points of baked objects again and stamp the measured errors."""
    objects = _objects(object_names)
    scene.check_objects(objects)
    marks = [_stamp_of(obj) for obj in objects]
    order = marks[0].order
    if any(mark.order != order for mark in marks):
        raise BakeError("The objects were baked with different orders: verify one order at a time")
    with engine.job_folder() as folder:
        yield jobs.Progress("scene", 0.0)
        job = _verify_job(object_names, replace(settings, order=order))
        results = yield from engine.run(job, folder)
    for obj, entry in zip(_objects(object_names), results.report["objects"], strict=True):
        error = entry["measured_error"]["on_surface"]
        stamp.write(obj, replace(_stamp_of(obj), measured_error=error))
    return results.report


def update_light(scene_name: str) -> Steps:
    """Read the world anew, whatever it is, and show its light on what is baked."""
    with engine.job_folder() as folder:
        yield jobs.Progress("light", 0.0)
        depsgraph = bpy.context.evaluated_depsgraph_get()
        light = world.read(bpy.data.scenes[scene_name], depsgraph, folder)
        results = yield from engine.run(jobs.Job("light", light=light.source), folder)
    _set_light(scene_name, light, results.image_sh, baked=False)
    return results.report


def _objects(names: Sequence[str]) -> list[bpy.types.Object]:
    """The objects of these names; BakeError where one is gone."""
    missing = [name for name in names if name not in bpy.data.objects]
    if missing:
        raise BakeError(f"There is no object {missing[0]!r} any more: bake again")
    return [bpy.data.objects[name] for name in names]


def _stamp_of(obj: bpy.types.Object) -> stamp.Stamp:
    found = stamp.read(obj)
    if found is None:
        raise BakeError(f"{obj.name} has no bake: bake it first")
    return found


def _read(
    scene_name: str,
    object_names: Sequence[str],
    settings: jobs.Settings,
    hdri: str | None,
    folder: Path,
) -> tuple[jobs.Job, WorldLight]:
    """The job of a bake, and the light that it reads."""
    depsgraph = bpy.context.evaluated_depsgraph_get()
    if hdri is None:
        light = world.read(bpy.data.scenes[scene_name], depsgraph, folder)
    else:
        light = world.from_file(hdri)
    vertices, triangles, repairs = scene.read_occluders(depsgraph)
    job = jobs.Job(
        settings=settings,
        light=light.source,
        receivers=scene.read_receivers(depsgraph, _objects(object_names)),
        occluder_vertices=vertices,
        occluder_triangles=triangles,
        repairs=repairs,
    )
    return job, light


def _verify_job(object_names: Sequence[str], settings: jobs.Settings) -> jobs.Job:
    depsgraph = bpy.context.evaluated_depsgraph_get()
    vertices, triangles, repairs = scene.read_occluders(depsgraph)
    objects = _objects(object_names)
    receivers = tuple(
        replace(receiver, transfer=attributes.read(obj, _stamp_of(obj)))
        for obj, receiver in zip(objects, scene.read_receivers(depsgraph, objects), strict=True)
    )
    return jobs.Job("verify", settings, None, receivers, vertices, triangles, repairs)


def _stamp(obj: bpy.types.Object, layout: Layout, domain: str) -> stamp.Stamp:
    """The stamp of ``obj`` as it is now, its figures still empty."""
    matrix = obj.matrix_world
    return stamp.Stamp(
        order=layout.order,
        channels=layout.channels,
        layout=layout.slots,
        carrier="vertex",
        domain=domain,
        by_modifier=carrier.needs_modifier(obj, bpy.context.evaluated_depsgraph_get()),
        job_hash="",
        mesh_signature=scene.mesh_signature(obj),
        matrix=tuple(value for column in matrix.to_3x3().transposed() for value in column),
        location=tuple(matrix.translation),
        points=0,
        rays=0,
        mrays_per_second=0.0,
    )


def _write(
    scene_name: str, results: jobs.Results, stamps: list[stamp.Stamp], layout: Layout
) -> None:
    """Put every result on its object, all or none."""
    objects = _objects([result.name for result in results.receivers])
    entries = results.report["objects"]
    figures = [
        replace(
            mark,
            job_hash=results.report["job_hash"],
            points=entry["points"],
            rays=results.report["settings"]["rays"],
            mrays_per_second=entry["mrays_per_second"],
            estimated_error=entry["estimated_error"],
            measured_error=(entry["measured_error"] or {}).get("on_surface"),
        )
        for mark, entry in zip(stamps, entries, strict=True)
    ]
    baked = list(zip(objects, results.receivers, figures, strict=True))
    writeback.write(bpy.data.scenes[scene_name], baked, layout)


def _set_light(scene_name: str, light: WorldLight, image_sh: Any, baked: bool) -> None:
    """Keep the light in the .blend and show it."""
    owner = bpy.data.scenes[scene_name]
    radiance = world_sh(image_sh, light.source.strength, light.source.rotation)
    before = light_state.read(owner)
    at_bake = radiance if baked or before is None else before.baked_radiance_sh
    state = light_state.LightState(light.image_key, image_sh, radiance, at_bake, light.follows)
    light_state.write(owner, state)
    writeback.set_light(radiance)
    live_light.refresh(owner, bpy.context.evaluated_depsgraph_get())
