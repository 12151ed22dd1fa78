"""What is baked: figures, stale bakes, the light that they show."""

import bpy

from ..addon import figures, light_state, live_light, selection, stamp
from . import wrap
from .panel import CROWD, SidebarPanel


class BakedPanel(SidebarPanel):
    """Mixin: a sub-panel of scenes that have bakes."""

    bl_parent_id = "PRT_PT_bake"

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """Only where something is baked."""
        return light_state.KEY in context.scene


class PRT_PT_result(BakedPanel, bpy.types.Panel):
    """The bakes that are selected, or all of them."""

    bl_label = "Result"

    def draw(self, context: bpy.types.Context) -> None:
        """Figures, then what can be done with the bakes."""
        layout = self.layout
        draw_figures(layout, context)
        row = layout.row(align=True)
        row.operator("prt.verify", icon="CHECKMARK")
        row.operator("prt.remove_bake", icon="TRASH")


class PRT_PT_light(BakedPanel, bpy.types.Panel):
    """The light that falls on the bakes."""

    bl_label = "Light"

    def draw(self, context: bpy.types.Context) -> None:
        """Whether it follows the world, and how to make it."""
        layout = self.layout
        state = light_state.read(context.scene)
        problem = live_light.problem(context.scene)
        if problem:
            wrap.box(layout, context, "ERROR", problem)
        elif state is not None and state.follows:
            layout.label(text="Follows the world", icon="WORLD")
        else:
            wrap.box(layout, context, "INFO", MUST_UPDATE)
        layout.operator("prt.update_light", icon="FILE_REFRESH")
        if has_lamps(context):
            wrap.box(layout, context, "INFO", NO_LAMPS)


class PRT_PT_export(BakedPanel, bpy.types.Panel):
    """Where the bakes can go."""

    bl_label = "Export"
    bl_options = {"DEFAULT_CLOSED"}

    def draw(self, context: bpy.types.Context) -> None:
        """The way to a .glb."""
        wrap.box(self.layout, context, "EXPORT", EXPORT)
        self.layout.operator("export_scene.gltf", text="Export glTF 2.0")


MUST_UPDATE = "This world cannot be followed: press Update Light after changing it"
NO_LAMPS = "Lamps are not in the bake: it holds the light of the world alone"
EXPORT = "The bakes go with File > Export > glTF 2.0, in any format"


def draw_figures(layout: bpy.types.UILayout, context: bpy.types.Context) -> None:
    """The figures of one bake, or of several together; bounded, for every redraw asks."""
    if not context.selected_objects and len(context.view_layer.objects) > CROWD:
        layout.label(text="Select a baked object")
        return
    objects = selection.baked_objects(context)
    stamps = selection.stamps([obj.name for obj in objects[:CROWD]])
    column = layout.column(align=True)
    if len(stamps) == 1:
        column.label(text=objects[0].name, icon="OBJECT_DATA")
        lines = figures.stamp_lines(stamps[0])
    else:
        lines = figures.summary_lines(stamps)
    for line in lines:
        column.label(text=line)
    draw_stale(layout, context, objects)


def draw_stale(
    layout: bpy.types.UILayout, context: bpy.types.Context, objects: list[bpy.types.Object]
) -> None:
    """The bakes that are switched off because their object is no longer what was baked."""
    names = [obj.name for obj in objects if obj.get(stamp.SWITCH) == 0.0]
    if names:
        more = f" and {len(names) - 3} more" if len(names) > 3 else ""
        sentence = f"Changed since the bake: {', '.join(names[:3])}{more}. Bake again"
        wrap.box(layout, context, "ERROR", sentence)


def has_lamps(context: bpy.types.Context) -> bool:
    """Whether lamps light the scene too."""
    if not bpy.data.lights:
        return False
    objects = context.view_layer.objects
    return len(objects) > CROWD or any(obj.type == "LIGHT" for obj in objects)
