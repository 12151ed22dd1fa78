"""Runs a long job from a button, once for all operators.

A job is a generator of ``Progress`` that returns a report.  ``execute`` runs it to its end (in the
background, from scripts); ``invoke`` lets Blender live meanwhile and takes a slice of it at every
tick of a timer.  However it ends, the generator is closed, the timer stopped, and panel and status
bar are cleared.  No Blender pointer outlives a tick: the workspace is kept by name.

The operators have no REGISTER: Repeat Last would run ``execute``, and Blender would freeze.
"""

from collections.abc import Callable, Generator
from time import monotonic
from typing import Any

import bpy

from ..addon import figures, run_state
from ..addon.prt.errors import BakeError
from ..addon.prt.job import Progress

Steps = Generator[Progress, None, dict[str, Any]]
Result = set[str]
TICK = 0.1  # seconds between ticks
SLICE = 0.03  # seconds of work at most in a tick, when the job yields that often

_driving: list["JobOperator"] = []  # the operator at work, one at most


class JobOperator:
    """Mixin of ``bpy.types.Operator``: give ``steps``, ``done`` and perhaps ``obstacle``."""

    bl_options = {"UNDO"}
    names: list[str]  # of the objects that the job is about
    _run: run_state.Run | None = None
    _steps: Steps | None = None
    _timer: bpy.types.Timer | None = None
    _workspace: str = ""

    def steps(self, context: bpy.types.Context) -> Steps:
        """The job, not begun; BakeError when it cannot begin."""
        raise NotImplementedError

    def done(self) -> str:
        """The sentence that the artist reads at the end."""
        raise NotImplementedError

    @classmethod
    def obstacle(cls, context: bpy.types.Context) -> str | None:  # noqa: ARG003
        """Why the button is grey, None when it is not; cheap, for every redraw asks."""
        return None

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """Grey, and say why."""
        reason = run_state.obstacle() or cls.obstacle(context)
        if reason:
            cls.poll_message_set(reason)
        return not reason

    def execute(self, context: bpy.types.Context) -> Result:
        """Run to the end; Blender does nothing else meanwhile."""
        return self._guarded(context, self._run_through)

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> Result:  # noqa: ARG002
        """Start, and let Blender go on."""
        return self._guarded(context, self._start_ticking)

    def modal(self, context: bpy.types.Context, event: bpy.types.Event) -> Result:
        """Take a tick, or give up; every other event is for the rest of Blender."""
        if self._run is None:
            return {"CANCELLED"}
        if self._run.stop or (event.type == "ESC" and event.value == "PRESS"):
            self._end(context)
            self.report({"INFO"}, f"{self.bl_label} was cancelled: nothing was changed")
            return {"CANCELLED"}
        if event.type == "TIMER":
            return self._guarded(context, self._tick)
        return {"PASS_THROUGH"}

    def cancel(self, context: bpy.types.Context) -> None:
        """Blender closes, or opens another file."""
        self._end(context)

    def _guarded(
        self, context: bpy.types.Context, work: Callable[[bpy.types.Context], Result]
    ) -> Result:
        """``work(context)``; a failure clears all, and a BakeError is told to the artist."""
        try:
            return work(context)
        except BakeError as error:
            self._end(context)
            self.report({"ERROR"}, str(error))
            return {"CANCELLED"}
        except BaseException:
            self._end(context)
            raise

    def _begin(self, context: bpy.types.Context) -> None:
        self._run = run_state.begin(self.bl_label)
        self._steps = self.steps(context)
        _driving.append(self)

    def _run_through(self, context: bpy.types.Context) -> Result:
        self._begin(context)
        while True:
            try:
                self._step()
            except StopIteration as end:
                return self._finish(context, end.value)

    def _start_ticking(self, context: bpy.types.Context) -> Result:
        self._begin(context)
        manager = context.window_manager
        self._workspace = context.workspace.name
        self._timer = manager.event_timer_add(TICK, window=context.window)
        manager.modal_handler_add(self)
        self._show(context)
        return {"RUNNING_MODAL"}

    def _tick(self, context: bpy.types.Context) -> Result:
        before = self._run.progress
        try:
            self._advance()
        except StopIteration as end:
            return self._finish(context, end.value)
        if self._run.progress != before:
            self._show(context)
        return {"PASS_THROUGH"}

    def _advance(self) -> None:
        """Work until the slice is over or there is nothing new to wait for."""
        end = monotonic() + SLICE
        while self._step() and monotonic() < end:
            pass

    def _step(self) -> bool:
        """One step of the job; whether it got on, for a job that only waits says so with -1."""
        progress = next(self._steps)
        moved = progress.fraction >= 0 and progress != self._run.progress
        if moved:
            self._run.progress = progress
        return moved

    def _finish(self, context: bpy.types.Context, report: dict[str, Any]) -> Result:
        self._end(context)
        for note in report.get("notes", ()):
            self.report({"WARNING"}, note)
        self.report({"INFO"}, self.done())
        return {"FINISHED"}

    def _end(self, context: bpy.types.Context) -> None:
        """Close and clear what was begun, and only that; safe to call again."""
        if self._run is None:
            return
        run, self._run = self._run, None
        run_state.end(run)
        if self in _driving:
            _driving.remove(self)
        try:
            if self._steps is not None:
                self._steps.close()
        finally:
            self._clear(context)

    def _clear(self, context: bpy.types.Context) -> None:
        if self._timer is not None:
            context.window_manager.event_timer_remove(self._timer)
            self._timer = None
            self._set_status(None)
            redraw_panels(context)

    def _show(self, context: bpy.types.Context) -> None:
        line = figures.progress_line(self._run.progress)
        self._set_status(f"{self.bl_label}: {line} (Esc to cancel)")
        redraw_panels(context)

    def _set_status(self, text: str | None) -> None:
        workspace = bpy.data.workspaces.get(self._workspace)
        if workspace is not None:
            workspace.status_text_set(text)


def redraw_panels(context: bpy.types.Context) -> None:
    """Redraw the sidebars alone: a whole viewport in EEVEE takes longer than a tick."""
    for window in context.window_manager.windows:
        for area in window.screen.areas:
            if area.type == "VIEW_3D":
                for region in area.regions:
                    if region.type == "UI":
                        region.tag_redraw()


def stop() -> None:
    """End the job at work, because its operator is about to go."""
    while _driving:
        _driving[0].cancel(bpy.context)
