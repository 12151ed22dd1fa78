"""The light of the bakes follows the world: turned, recoloured, animated or with another image.

Only coefficients are turned and scaled, unless the image is another one: then the engine projects
it.  A scene without a bake costs one look at its custom properties.
"""

from dataclasses import replace

import bpy
import numpy as np
from bpy.app.handlers import persistent

from . import engine, light_state, live_reflections, world, writeback
from .light_state import Coefficients, LightState
from .prt.errors import BakeError
from .prt.light.projection import world_sh
from .world import SimpleWorld

WATCHED = ("WORLD", "NODETREE", "IMAGE")

problem = ""  # why the light does not follow the world, one sentence for the panel

# By the name of the scene: the world and the kept light that agree, so that nothing is done twice.
_settled: dict[str, tuple[SimpleWorld | None, str]] = {}


def refresh(scene: bpy.types.Scene, depsgraph: bpy.types.Depsgraph) -> bool:
    """Let the light of ``scene`` be that of its evaluated world; whether anything was written.

    A world that can't be read leaves the light as it was, and ``problem`` says why.
    """
    global problem  # noqa: PLW0603 - the panel reads it
    kept = scene.get(light_state.KEY)
    if kept is None:
        return False
    try:
        simple = world.read_nodes(scene, depsgraph)
    except BakeError as error:
        problem = str(error)
        _settled.pop(scene.name, None)
        return False
    if _settled.get(scene.name) == (simple, kept) and _is_reflected(simple):
        return False
    changed, problem = _follow(scene, simple)
    _settled[scene.name] = (simple, scene[light_state.KEY])
    return changed


def show(scene: bpy.types.Scene, state: LightState) -> None:
    """Keep ``state`` as the light of ``scene`` and show it."""
    writeback.set_light(state)
    light_state.write(scene, state)


def _follow(scene: bpy.types.Scene, simple: SimpleWorld | None) -> tuple[bool, str]:
    """Show and keep the light of ``simple``: whether it is another one, and what hindered."""
    state = light_state.read(scene)
    if state is None or not state.follows:
        return False, ""
    if simple is None:
        return False, "The world's nodes have to be rendered: press Update Light"
    try:
        image_sh = _image_sh(simple, state)
    except BakeError as error:
        return False, str(error)
    radiance = world_sh(image_sh, simple.strength, simple.rotation)
    now = replace(
        state,
        image_key=simple.image_key,
        image_sh=image_sh,
        radiance_sh=radiance,
        rotation=simple.rotation,
        strength=simple.strength,
    )
    changed = not _same(now, state)
    if changed:
        show(scene, now)
    return changed, live_reflections.follow(scene, simple)


def _is_reflected(simple: SimpleWorld | None) -> bool:
    """Whether shiny materials need nothing either."""
    return simple is None or live_reflections.agree(simple)


def _same(now: LightState, before: LightState) -> bool:
    """Whether nothing has to be written."""
    kept = (now.image_key, now.rotation, now.strength)
    return kept == (before.image_key, before.rotation, before.strength) and np.array_equal(
        now.radiance_sh, before.radiance_sh
    )


def _image_sh(simple: SimpleWorld, state: LightState) -> Coefficients:
    """The image's coefficients: the kept ones, or by the engine where it is another image."""
    if simple.image_key == state.image_key:
        return state.image_sh
    with engine.job_folder() as work, engine.job_folder() as folder:
        results = engine.run_light(world.source(simple, folder), work)
    image_sh: Coefficients = results.image_sh
    return image_sh


@persistent
def _on_update(scene: bpy.types.Scene, depsgraph: bpy.types.Depsgraph) -> None:
    if light_state.KEY in scene and any(map(depsgraph.id_type_updated, WATCHED)):
        refresh(scene, depsgraph)


@persistent
def _on_frame(scene: bpy.types.Scene, depsgraph: bpy.types.Depsgraph) -> None:
    refresh(scene, depsgraph)


def register() -> None:
    """Follow the world, when it is edited and when it is animated."""
    bpy.app.handlers.depsgraph_update_post.append(_on_update)
    bpy.app.handlers.frame_change_post.append(_on_frame)


def unregister() -> None:
    """Follow it no more."""
    bpy.app.handlers.frame_change_post.remove(_on_frame)
    bpy.app.handlers.depsgraph_update_post.remove(_on_update)
