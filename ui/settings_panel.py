"""How finely to bake."""

import bpy

from ..addon.prt.layout import MAX_ATTRIBUTES, Layout
from .panel import SidebarPanel


class PRT_PT_settings(SidebarPanel, bpy.types.Panel):
    """The settings of the next bake."""

    bl_label = "Settings"
    bl_parent_id = "PRT_PT_bake"

    def draw(self, context: bpy.types.Context) -> None:
        """Order with what it costs, rays, seed, threads."""
        chosen = context.scene.prt
        layout = self.layout
        layout.use_property_split = True
        layout.use_property_decorate = False
        layout.prop(chosen, "order")
        used = len(Layout(chosen.order).attributes)
        hint = layout.row()
        hint.active = False
        hint.alignment = "RIGHT"
        hint.label(text=f"{used} of EEVEE's {MAX_ATTRIBUTES} attributes")
        layout.prop(chosen, "rays")
        layout.prop(chosen, "seed")
        layout.prop(chosen, "threads")
