"""What shiny materials reflect follows the HDRI, some seconds behind the light.

Filtering a picture takes the engine seconds, so its process does it beside Blender's work: until it
is done the old image is reflected.  A render waits for it, and so does Blender without a window,
where no timer ever fires.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace

import bpy
from bpy.app.handlers import persistent

from . import cache_folder, engine, light_state, nodes, reflections, world, writeback
from .light_state import LightState
from .prt.errors import BakeError
from .prt.job import Job, Settings
from .prt.light import residual
from .world import SimpleWorld

TICK = 0.2  # seconds between looks at the engine
ALIKE = 0.5  # likeness of two lights whose lamps are the same


@dataclass(frozen=True)
class _Filtering:
    """The picture ``key`` is filtered for ``scene`` by ``steps``."""

    key: str
    scene: str
    steps: Iterator[object]


_at_work: list[_Filtering] = []  # one at most
_failed: list[str] = []  # keys of pictures that cannot be filtered: one try each


def settings(state: LightState | None) -> Settings:
    """What the engine is asked for under the light ``state``, so that the file's materials can
    reflect it: lamps are cut out of it where it is the baked light, turned or not, for then the
    shadows of their highlights are baked."""
    layouts = [nodes.layout_of(tree) for tree in nodes.groups()]
    if reflections.current() is None or not layouts:
        return Settings()
    wanted = Settings(reflections=True, cache=cache_folder.path())
    most = max(layouts, key=lambda layout: layout.lights)
    if state is None or not most.lights or not _is_baked_light(state):
        return wanted
    return replace(wanted, peaks=most.lights, order=most.order)


def _is_baked_light(state: LightState) -> bool:
    now, baked = state.radiance_sh, state.baked_radiance_sh
    angle = residual.turn_angle(now, baked)
    return residual.likeness(now, residual.turned(baked, angle)) > ALIKE


def agree(simple: SimpleWorld) -> bool:
    """Whether nothing has to be done: what is reflected is ``simple``'s picture, or will be, or
    can't be."""
    if _at_work:
        return _at_work[0].key == simple.image_key
    return _is_reflected(simple.image_key) or simple.image_key in _failed


def follow(scene: bpy.types.Scene, simple: SimpleWorld) -> str:
    """Let shiny materials reflect ``simple``, at once where nobody could wait for it; what
    hindered, or "".  The light of ``scene`` is that of ``simple`` already."""
    if agree(simple):
        return ""
    stop()
    if _is_reflected(simple.image_key):
        return ""
    wanted = settings(light_state.read(scene))
    _at_work.append(_Filtering(simple.image_key, scene.name, _steps(simple, wanted)))
    if must_wait():
        return finish()
    bpy.app.timers.register(_tick, first_interval=TICK)
    return ""


def must_wait() -> bool:
    """Whether a later moment would be too late."""
    return bpy.app.background or bpy.app.is_job_running("RENDER")


def finish() -> str:
    """Wait for what is at work; what hindered, or ""."""
    while True:
        problem = _advanced()
        if problem is not None:
            return problem


def stop() -> None:
    """Give up what is at work: the engine's process is killed."""
    while _at_work:
        _at_work.pop().steps.close()
    if bpy.app.timers.is_registered(_tick):
        bpy.app.timers.unregister(_tick)


def _steps(simple: SimpleWorld, wanted: Settings) -> Iterator[object]:
    with engine.job_folder() as work, engine.job_folder() as folder:
        job = Job("light", wanted, world.source(simple, folder))
        results = yield from engine.run(job, work)
        if _is_reflected(simple.image_key):  # by a bake meanwhile, or nothing is any more
            return
        with reflections.loaded(results.reflections, simple.image_key) as reflected:
            writeback.reflect(reflected)


def _advanced() -> str | None:
    """Go a step on with what is at work; when it is over, what hindered, or ""."""
    if not _at_work:
        return ""
    one = _at_work[0]
    try:
        next(one.steps)
    except StopIteration:
        _at_work.remove(one)
        _relight(one.scene)
        return ""
    except BakeError as error:
        _at_work.remove(one)
        _failed.append(one.key)
        return str(error)
    except BaseException:
        _at_work.remove(one)
        raise
    return None


def _relight(scene_name: str) -> None:
    """The new image has a scale and lamps of its own."""
    scene = bpy.data.scenes.get(scene_name)
    state: LightState | None = None if scene is None else light_state.read(scene)
    if state is not None:
        nodes.set_light(state)


def _is_reflected(key: str) -> bool:
    """Whether nothing is reflected, or the picture ``key``."""
    image = reflections.current()
    return image is None or reflections.of(image).key == key


def _tick() -> float | None:
    return TICK if _advanced() is None else None


@persistent
def _on_render(*_: object) -> None:
    finish()


@persistent
def _on_load(*_: object) -> None:
    stop()
    _failed.clear()


def register() -> None:
    """Renders wait; another file ends what is at work for this one."""
    bpy.app.handlers.render_init.append(_on_render)
    bpy.app.handlers.load_pre.append(_on_load)


def unregister() -> None:
    """Nothing is at work any more."""
    stop()
    bpy.app.handlers.load_pre.remove(_on_load)
    bpy.app.handlers.render_init.remove(_on_render)
