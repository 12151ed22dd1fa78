"""Bake, verify and light update from beginning to end, as generators of progress.

Nothing of the scene changes before the whole result is there, and closing a generator leaves the
scene as it was.  Between two steps only names are kept: an undo kills pointers.
"""

from collections.abc import Generator, Sequence
from dataclasses import replace
from math import sqrt
from pathlib import Path
from typing import Any

import bpy
import numpy as np

from . import (
    albedo_state,
    attributes,
    bake_plan,
    carrier,
    engine,
    figures,
    light_state,
    live_light,
    live_reflections,
    reflections,
    scene,
    scene_occluders,
    stamp,
    textures,
    world,
    world_file,
    writeback,
)
from .atlas_files import Target
from .prt import job as jobs
from .prt import layout as layouts
from .prt.bounces.sources import channels_of
from .prt.errors import BakeError
from .prt.layout import Layout
from .prt.light import residual
from .prt.light.projection import world_sh
from .prt.results import ReceiverResult, Results
from .world import WorldLight

Report = dict[str, Any]
Steps = Generator[jobs.Progress, None, Report]
VERTICES = Target()


def bake(
    scene_name: str,
    object_names: Sequence[str],
    settings: jobs.Settings,
    hdri: str | None = None,
    target: Target = VERTICES,
) -> Steps:
    """Bake the objects to ``target`` and light them; the report is the generator's value, with what
    the artist should know in ``notes``, one sentence each.

    ``hdri`` names an image that becomes the scene's world with the result; a cubemap, which no
    world can show, only lights the bake.
    """
    with engine.job_folder() as folder:
        objects = _objects(object_names)
        target.check(settings.engine_images)
        receivers = textures.receivers(objects, scene.check_objects(objects), target)
        occluders = scene_occluders.read(
            bpy.context.evaluated_depsgraph_get(), with_albedo=settings.bounces != 0
        )
        channels = channels_of(occluders.albedo)
        least, most = bake_plan.possible(bpy.data.scenes[scene_name], settings, hdri, channels)
        carriers = [receiver.carrier for receiver in receivers]
        owner, reflects = bpy.data.scenes[scene_name], settings.reflections
        writeback.check(owner, objects, most, least, carriers, reflections=reflects)
        largest = bake_plan.largest_image(settings, most) if target.carrier != "vertex" else 0
        notes = writeback.notes(bpy.data.scenes[scene_name], objects, largest)
        notes += map(figures.does_not_light, occluders.emitters)
        stamps = [
            replace(_stamp(obj, most, receiver.domain), bounces=settings.bounces)
            for obj, receiver in zip(objects, receivers, strict=True)
        ]
        yield jobs.Progress("scene", 0.0)
        owner = bpy.data.scenes[scene_name]
        reflects = writeback.reflects(owner, objects, wanted=settings.reflections)
        settings = bake_plan.settled(settings, most, reflects=reflects)
        job = jobs.Job(settings=settings, receivers=receivers, **_standing(occluders))
        light = _light(scene_name, hdri, folder)
        job = replace(job, light=light.source)
        results = yield from engine.run(job, folder)
        is_cubemap = results.report["light"]["projection"] == "cubemap"
        state = _light_state(light, results, follows=light.follows and not is_cubemap)
        with (
            textures.images(results, target) as images,
            reflections.loaded(results.reflections, light.image_key) as reflected,
        ):
            shown = images, reflected
            if hdri is None or is_cubemap:
                _write(scene_name, results, stamps, state, shown)
            else:
                with world_file.made(hdri) as its_world:
                    _write(scene_name, results, stamps, state, shown)
                bpy.data.scenes[scene_name].world = its_world
    owner, job_hash = bpy.data.scenes[scene_name], results.report["job_hash"]
    albedo_state.keep(owner, job_hash, occluders.reflecting)
    notes += map(figures.another_light, _take_as_baked(scene_name, state, object_names))
    return {**results.report, "notes": notes}


def verify(scene_name: str, object_names: Sequence[str], settings: jobs.Settings) -> Steps:
    """Trace points of baked objects again, under the world as it is, and stamp the measured
    errors."""
    objects = _objects(object_names)
    receivers = scene.check_objects(objects)
    marks = [_stamp_of(obj) for obj in objects]
    order, bounces = marks[0].order, marks[0].bounces
    if any(mark.order != order for mark in marks):
        raise BakeError("The objects were baked with different orders: verify one order at a time")
    if any(mark.bounces != bounces for mark in marks):
        raise BakeError(
            "The objects were baked with different bounces: verify those with the same together"
        )
    state = light_state.read(bpy.data.scenes[scene_name])
    receivers = tuple(
        _with_what_is_shown(*one, state, settings)
        for one in zip(receivers, objects, marks, strict=True)
    )
    with engine.job_folder() as folder:
        yield jobs.Progress("scene", 0.0)
        settings = replace(settings, order=order, bounces=bounces)
        job = _verify_job(scene_name, receivers, settings, folder)
        results = yield from engine.run(job, folder)
    for obj, entry in zip(_objects(object_names), results.report["objects"], strict=True):
        at_bake = state is not None and light_state.is_baked(state) and stamp.share(obj) == 1.0
        found = _measured(entry["measured_error"])
        stamp.write(obj, replace(_stamp_of(obj), **found, light_at_bake=at_bake))
    return results.report


def update_light(scene_name: str) -> Steps:
    """Read the world anew, whatever it is, and show its light on what is baked."""
    with engine.job_folder() as folder:
        yield jobs.Progress("light", 0.0)
        depsgraph, owner = bpy.context.evaluated_depsgraph_get(), bpy.data.scenes[scene_name]
        light = world.read(owner, depsgraph, folder)
        settings = live_reflections.settings(light_state.read(owner))
        job = jobs.Job("light", settings, light.source)
        results = yield from engine.run(job, folder)
        with reflections.loaded(results.reflections, light.image_key) as reflected:
            writeback.reflect(reflected)
    state = _light_state(light, results, light.follows)
    before = light_state.read(bpy.data.scenes[scene_name])
    if before is not None:
        baked = before.baked_radiance_sh
        state = replace(state, baked_radiance_sh=baked, peaks=before.peaks)
    _set_light(scene_name, state)
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


def _light(scene_name: str, hdri: str | None, folder: Path) -> WorldLight:
    """The light of a bake."""
    if hdri is not None:
        return world.from_file(hdri)
    depsgraph = bpy.context.evaluated_depsgraph_get()
    return world.read(bpy.data.scenes[scene_name], depsgraph, folder)


def _standing(found: scene_occluders.Occluders) -> dict[str, Any]:
    """What a job says of all that stops light."""
    return {
        "occluder_vertices": found.vertices,
        "occluder_triangles": found.triangles,
        "occluder_starts": found.starts,
        "occluder_albedo": found.albedo,
        "repairs": found.repairs,
    }


def _verify_job(
    scene_name: str,
    receivers: tuple[jobs.Receiver, ...],
    settings: jobs.Settings,
    folder: Path,
) -> jobs.Job:
    """Without a light where the world has none: the transfer can still be verified."""
    depsgraph = bpy.context.evaluated_depsgraph_get()
    try:
        light = world.read(bpy.data.scenes[scene_name], depsgraph, folder).source
    except BakeError:
        light = None
    found = scene_occluders.read(depsgraph, with_albedo=settings.bounces != 0)
    return jobs.Job("verify", settings, light, receivers, **_standing(found))


def _with_what_is_shown(
    receiver: jobs.Receiver,
    obj: bpy.types.Object,
    mark: stamp.Stamp,
    state: light_state.LightState | None,
    settings: jobs.Settings,
) -> jobs.Receiver:
    """``receiver`` with the transfer that it shows, with what is seen where that is stored, and one
    residual: all that it shows besides, under the light of ``state``."""
    if mark.in_atlas:
        count, seed = settings.verify_points, settings.seed
        receiver, values = textures.with_what_is_shown(receiver, obj, mark, count, seed)
    else:
        values = attributes.read(obj, mark)
    seen = values.visibility_sh if mark.packing.visibility_order else None
    receiver = replace(receiver, transfer=values.transfer, visibility_sh=seen)
    if state is None or not mark.beyond_transfer:
        return receiver
    terms = light_state.terms(state, mark.packing)
    beyond = residual.beyond(values, terms, stamp.share(obj)).astype(np.float32)
    return replace(receiver, residual=beyond[:, None])


def _stamp(obj: bpy.types.Object, layout: Layout, domain: str) -> stamp.Stamp:
    """The stamp of ``obj`` as it is now; ``layout`` may become less."""
    by_modifier = carrier.needs_modifier(obj, bpy.context.evaluated_depsgraph_get())
    return stamp.blank(obj, layout, domain, by_modifier, scene.mesh_signature(obj))


def _write(
    scene_name: str,
    results: Results,
    stamps: list[stamp.Stamp],
    state: light_state.LightState,
    shown: tuple[Sequence[bpy.types.Image], bpy.types.Image | None],
) -> None:
    """Put every result on its object, all or none; ``shown`` are the atlases, and what is
    reflected."""
    objects = _objects([result.name for result in results.receivers])
    layout = layouts.covering(results.receivers)
    marks = [
        replace(mark, **_figures(layout, result, entry, results.report, state))
        for mark, result, entry in zip(
            stamps, results.receivers, results.report["objects"], strict=True
        )
    ]
    baked = list(zip(objects, results.receivers, marks, strict=True))
    writeback.write(bpy.data.scenes[scene_name], baked, layout, *shown)


def _figures(
    layout: Layout,
    result: ReceiverResult,
    entry: Report,
    report: Report,
    state: light_state.LightState,
) -> dict[str, Any]:
    """What a stamp says of a bake that is done."""
    in_atlas = result.in_atlas is not None
    placed = {"carrier": "vertex"}
    if in_atlas:
        names = ("carrier", "atlas_size", "uv_key", "own_uvs")
        placed = {"domain": "CORNER", **{name: entry[name] for name in names}}
    return {
        **placed,
        "why": figures.why(placed["carrier"], entry["predicted"]) if "predicted" in entry else "",
        "order": layout.order,
        "channels": layout.channels,
        "layout": layout.slots,
        "direct": result.direct is not None,
        "job_hash": report["job_hash"],
        "points": entry["points"],
        "rays": round(entry.get("rays_per_point", report["settings"]["rays"])),
        "mrays_per_second": entry["mrays_per_second"],
        "estimated_error": entry["surface_error"] if in_atlas else _noise(entry),
        "interpolation_error": None if in_atlas else entry.get("interpolation_error"),
        "plain_error": _plain_error(layout, result, state),
        **_measured(entry["measured_error"]),
        **({"measured_at_points": None} if _is_fitted(entry) else {}),
    }


def _is_fitted(entry: Report) -> bool:
    """Whether a fit shows less noise than there was where its rays started."""
    return bool(entry.get("values", {}).get("fitted", 0) > 0.5)


def _noise(entry: Report) -> float:
    """The noise that is shown."""
    if not _is_fitted(entry):
        return float(entry["estimated_error"])
    return sqrt(max(0.0, entry["surface_error"] ** 2 - entry["interpolation_error"] ** 2))


def _measured(error: Report | None) -> dict[str, float | None]:
    """What a stamp says of the measured errors in a report."""
    found = error or {}
    return {
        "measured_error": found.get("on_surface"),
        "measured_at_points": found.get("at_points"),
        "light_error": found.get("light_on_surface"),
        "visibility_error": found.get("visibility_on_surface"),
    }


def _plain_error(
    layout: Layout, result: ReceiverResult, state: light_state.LightState
) -> float | None:
    """Relative RMS of what the transfer alone leaves out of the baked light; None where nothing
    mends it."""
    if not (layout.turns or layout.lights):
        return None
    values = layouts.Values(result.transfer, result.residual, result.visibility)
    stored = Layout(layout.order, layout.channels, values.residual.shape[1], layout.lights)
    beyond = residual.beyond(values, light_state.terms(state, stored))
    whole = beyond + residual.shaded(result.transfer, state.radiance_sh)
    size = float(np.square(whole).sum())
    return float(np.sqrt(np.square(beyond).sum() / size)) if size else None


def _light_state(light: WorldLight, results: Results, follows: bool) -> light_state.LightState:
    """The light of ``results``, as if everything were baked under it."""
    image_sh = results.image_sh
    rotation, strength = light.source.rotation, light.source.strength
    radiance = world_sh(image_sh, strength, rotation)
    return light_state.LightState(
        light.image_key, image_sh, radiance, radiance, follows, results.peaks, rotation, strength
    )


def _take_as_baked(
    scene_name: str, state: light_state.LightState, object_names: Sequence[str]
) -> list[str]:
    """Make ``state`` the light that residuals are weighed against, and show it.  Of what was baked
    under another light only the transfer is shown, unless that one was only stronger or weaker;
    returns the names of those that lose their residual by it."""
    owner, lost = bpy.data.scenes[scene_name], []
    before = light_state.read(owner)
    for obj in stamp.baked_objects(owner) if before is not None else ():
        mark = stamp.read(obj)
        if obj.name in object_names or mark is None or not stamp.share(obj):
            continue
        kept = light_state.share(before, state, with_peaks=mark.packing.lights > 0)
        stamp.set_share(obj, kept * stamp.share(obj))
        if not kept and mark.beyond_transfer:
            lost.append(obj.name)
    _set_light(scene_name, state)
    return lost


def _set_light(scene_name: str, state: light_state.LightState) -> None:
    """Keep the light in the .blend and show it, or that of the world where that has changed."""
    owner = bpy.data.scenes[scene_name]
    live_light.show(owner, state)
    live_light.refresh(owner, bpy.context.evaluated_depsgraph_get())
