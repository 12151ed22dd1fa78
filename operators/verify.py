"""Verify: some points of the bakes traced again by brute force."""

import bpy

from ..addon import bake, figures, properties, selection
from .job_driver import JobOperator, Steps


class PRT_OT_verify(JobOperator, bpy.types.Operator):
    """Trace random points of the selected bakes, or of all bakes if none is selected, again by
    brute force and show the error"""

    bl_idname = "prt.verify"
    bl_label = "Verify"

    @classmethod
    def obstacle(cls, context: bpy.types.Context) -> str | None:
        """Nothing to compare with."""
        return selection.nothing_baked(context.scene)

    def steps(self, context: bpy.types.Context) -> Steps:
        """Measure the error of each bake."""
        self.names = [obj.name for obj in selection.baked_objects(context)]
        chosen = properties.settings(context.scene, verify=True)
        return bake.verify(context.scene.name, self.names, chosen)

    def done(self) -> str:
        """The worst of the errors."""
        return f"Verified {', '.join(figures.summary_lines(selection.stamps(self.names)))}"
