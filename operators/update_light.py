"""Update Light: read the world again, for changes that Blender does not announce."""

import bpy

from ..addon import bake, selection
from .job_driver import JobOperator, Steps


class PRT_OT_update_light(JobOperator, bpy.types.Operator):
    """Read the world's light again, for instance after painting on the HDRI; no bake is needed"""

    bl_idname = "prt.update_light"
    bl_label = "Update Light"

    @classmethod
    def obstacle(cls, context: bpy.types.Context) -> str | None:
        """Nothing that the light could fall on."""
        return selection.nothing_baked(context.scene)

    def steps(self, context: bpy.types.Context) -> Steps:
        """Project the light again."""
        return bake.update_light(context.scene.name)

    def done(self) -> str:
        """The bakes show it."""
        return "The bakes show the world as it is now"
