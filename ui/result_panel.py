"""What is baked: figures, stale bakes, the light that they show."""

import bpy

from ..addon import figures, light_state, live_light, selection, stale, stamp
from . import wrap
from .panel import CROWD, SidebarPanel

MUST_UPDATE = "This world cannot be followed: press Update Light after changing it"
NO_LAMPS = "Lamps are not in the bake: it holds the light of the world alone"
CHANGED = "changed since the bake, which is not shown: bake again"
ANOTHER_LIGHT = "were baked under another world and show soft shadows alone: bake them again"
EXPORT = "The bakes go with File > Export > glTF 2.0, in any format"


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
        if live_light.problem:
            wrap.box(layout, context, "ERROR", live_light.problem)
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


def draw_figures(layout: bpy.types.UILayout, context: bpy.types.Context) -> None:
    """The figures of one bake, or of several together; bounded, for every redraw asks."""
    if not context.selected_objects and len(context.view_layer.objects) > CROWD:
        layout.label(text="Select a baked object to see its figures")
        return
    objects = selection.baked_objects(context)
    if len(objects) > CROWD:
        layout.label(text=f"{len(objects):,} baked objects")
        return
    stamps = [mark for mark in map(stamp.read, objects) if mark is not None]
    single = len(stamps) == 1
    column = layout.column(align=True)
    column.label(text=objects[0].name if single else "Together", icon="OBJECT_DATA")
    for line in figures.stamp_lines(stamps[0]) if single else figures.summary_lines(stamps):
        wrap.lines(column, context, line[0].upper() + line[1:])
    if single and (advice := figures.advice(stamps[0])):
        wrap.box(layout, context, "INFO", advice)
    draw_another_light(layout, context, objects)
    draw_stale(layout, context, objects)


def draw_another_light(
    layout: bpy.types.UILayout, context: bpy.types.Context, objects: list[bpy.types.Object]
) -> None:
    """Which bakes have a residual that is not shown."""
    without = [obj for obj in objects if obj.get(stamp.SWITCH) == 1.0 and not stamp.share(obj)]
    marked = ((obj, stamp.read(obj)) for obj in without)
    names = [obj.name for obj, mark in marked if mark and mark.beyond_transfer]
    if len(names) == 1:
        wrap.box(layout, context, "INFO", figures.another_light(names[0]))
    elif names:
        wrap.box(layout, context, "INFO", f"{len(names)} objects {ANOTHER_LIGHT}")


def draw_stale(
    layout: bpy.types.UILayout, context: bpy.types.Context, objects: list[bpy.types.Object]
) -> None:
    """Why bakes are switched off, and what to do."""
    hidden = [obj for obj in objects if obj.get(stamp.SWITCH) == 0.0]
    if len(hidden) > 1:
        wrap.box(layout, context, "ERROR", f"{len(hidden)} objects {CHANGED}")
    elif hidden and (mark := stamp.read(hidden[0])):
        reason = stale.reason(hidden[0], mark)
        wrap.box(layout, context, "ERROR", reason or f"{hidden[0].name} {CHANGED}")


def has_lamps(context: bpy.types.Context) -> bool:
    """Whether lamps light the scene too."""
    if not bpy.data.lights:
        return False
    objects = context.view_layer.objects
    return len(objects) > CROWD or any(obj.type == "LIGHT" for obj in objects)
