"""Cancel: the panel's way to do what Esc does."""

import bpy

from ..addon import run_state


class PRT_OT_cancel(bpy.types.Operator):
    """Stop what is running and leave the scene as it was"""

    bl_idname = "prt.cancel"
    bl_label = "Cancel"
    bl_options = {"INTERNAL"}

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:  # noqa: ARG003
        """Grey when nothing runs."""
        running = run_state.current() is not None
        if not running:
            cls.poll_message_set("Nothing is running")
        return running

    def execute(self, context: bpy.types.Context) -> set[str]:  # noqa: ARG002
        """Ask the job to end; it does at its next tick."""
        run = run_state.current()
        if run is not None:
            run.stop = True
        return {"FINISHED"}
