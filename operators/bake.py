"""Bake: the objects' light transfer, traced and shown in EEVEE."""

import bpy

from ..addon import bake, figures, properties, scene, selection
from .job_driver import JobOperator, Steps


class PRT_OT_bake(JobOperator, bpy.types.Operator):
    """Bake the shadowed light of the selected meshes, or of every visible mesh if none is
    selected; the world's HDRI can be turned or swapped afterwards"""

    bl_idname = "prt.bake"
    bl_label = "Bake PRT"

    @classmethod
    def obstacle(cls, context: bpy.types.Context) -> str | None:
        """No world, or in Edit Mode."""
        if context.scene.world is None:
            return "The scene has no world: add one in the World tab of the properties"
        if context.mode.startswith("EDIT"):
            return "Leave Edit Mode first: press Tab"
        return None

    def steps(self, context: bpy.types.Context) -> Steps:
        """Bake what is selected."""
        self.names = [obj.name for obj in scene.default_objects(context)]
        scene_now = context.scene
        chosen, target = properties.settings(scene_now), properties.target(scene_now)
        return bake.bake(scene_now.name, self.names, chosen, None, target)

    def done(self) -> str:
        """How much was baked and how noisy it is."""
        return f"Baked {', '.join(figures.summary_lines(selection.stamps(self.names)))}"
