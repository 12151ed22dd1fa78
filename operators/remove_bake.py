"""Remove Bake: meshes and materials as they were before."""

import bpy

from ..addon import figures, remove, run_state, selection
from ..addon.prt.errors import BakeError


class PRT_OT_remove_bake(bpy.types.Operator):
    """Take the bake off the selected objects, or off all if no baked one is selected; meshes and
    materials are again as they were"""

    bl_idname = "prt.remove_bake"
    bl_label = "Remove Bake"
    bl_options = {"REGISTER", "UNDO"}

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """Grey while a job runs and where nothing is baked."""
        reason = run_state.obstacle() or selection.nothing_baked(context.scene)
        if reason:
            cls.poll_message_set(reason)
        return not reason

    def execute(self, context: bpy.types.Context) -> set[str]:
        """Remove, and say from how many."""
        try:
            count = remove.remove(context.scene, selection.baked_objects(context))
        except BakeError as error:
            self.report({"ERROR"}, str(error))
            return {"CANCELLED"}
        self.report({"INFO"}, f"Removed the bake of {figures.objects(count)}")
        return {"FINISHED"}
