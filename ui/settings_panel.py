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
        layout = split(self.layout)
        layout.prop(chosen, "order")
        hint = layout.row()
        hint.active = False
        hint.alignment = "RIGHT"
        hint.label(text=f"{used_attributes(chosen)} of EEVEE's {MAX_ATTRIBUTES} attributes")
        layout.prop(chosen, "quality")
        layout.prop(chosen, "rays" if chosen.quality == "RAYS" else "tolerance")
        layout.prop(chosen, "seed")
        layout.prop(chosen, "threads")


class PRT_PT_exact(SidebarPanel, bpy.types.Panel):
    """What the next bake stores for the very world that it is baked under."""

    bl_label = "This World"
    bl_parent_id = "PRT_PT_settings"

    def draw(self, context: bpy.types.Context) -> None:
        """The residual, its turns, peaks, and whether the light is final."""
        chosen = context.scene.prt
        layout = split(self.layout)
        layout.prop(chosen, "residual")
        turns = layout.row()
        turns.active = chosen.residual
        turns.prop(chosen, "turns")
        layout.prop(chosen, "peaks")
        layout.prop(chosen, "final_light")


def split(layout: bpy.types.UILayout) -> bpy.types.UILayout:
    """``layout`` with names on the left and values on the right."""
    layout.use_property_split = True
    layout.use_property_decorate = False
    return layout


def used_attributes(chosen: bpy.types.PropertyGroup) -> int:
    """How many vertex attributes a bake takes at most."""
    turns = chosen.turns if chosen.residual else 0
    return len(Layout(chosen.order, 1, turns, chosen.peaks).attributes)
