"""The main panel: Bake, how far it is, and what is in its way."""

import bpy

from ..addon import figures, run_state
from . import wrap

CROWD = 500  # objects in the view layer that can still be counted at every redraw
NO_WORLD = "The scene has no world, so there is no light to bake"


class SidebarPanel:
    """Mixin: a panel in the 3D view's sidebar, tab PRT."""

    bl_space_type = "VIEW_3D"
    bl_region_type = "UI"
    bl_category = "PRT"


class PRT_PT_bake(SidebarPanel, bpy.types.Panel):
    """The Bake button, or the bar of the job that runs."""

    bl_label = "PRT Baker"

    def draw(self, context: bpy.types.Context) -> None:
        """Top of the tab."""
        layout = self.layout
        run = run_state.current()
        if run is not None:
            draw_progress(layout, run)
            return
        if context.scene.world is None:
            wrap.box(layout, context, "ERROR", NO_WORLD)
            layout.template_ID(context.scene, "world", new="world.new")
        column = layout.column()
        column.scale_y = 1.5
        # No label below: Blender takes it for the bar that was here, and paints it like one
        column.operator("prt.bake", text=what_is_baked(context), icon="LIGHT_HEMI")


def draw_progress(layout: bpy.types.UILayout, run: run_state.Run) -> None:
    """What runs, how far it is, when it will be done, and a way to stop it."""
    progress = run.progress
    row = layout.row(align=True)
    row.scale_y = 1.5
    row.progress(factor=progress.fraction, text=f"{run.label}: {100 * progress.fraction:.0f} %")
    row.operator("prt.cancel", text="", icon="X")
    left = progress.seconds_left
    tail = f", {figures.duration(left)} left" if left is not None else ""
    layout.label(text=f"{figures.phase(progress)}{tail}")


def what_is_baked(context: bpy.types.Context) -> str:
    """The button's text."""
    selected = sum(obj.type == "MESH" for obj in context.selected_objects)
    if selected:
        return f"Bake {selected} Selected Object{'s' * (selected > 1)}"
    if len(context.view_layer.objects) > CROWD:
        return "Bake All Visible Meshes"
    visible = sum(obj.type == "MESH" for obj in context.visible_objects)
    return f"Bake {visible} Visible Object{'s' * (visible > 1)}" if visible else "Bake PRT"
