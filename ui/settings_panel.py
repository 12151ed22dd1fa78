"""How finely to bake."""

from dataclasses import replace

import bpy

from ..addon.prt.layout import MAX_ATTRIBUTES, Layout
from ..addon.prt.tiles import tile_grid
from .panel import SidebarPanel

REFLECTIONS = "a texture of 30 MB, 3 s a new HDRI"
BYTES = 16  # four floats
MIPS = 4 / 3  # a texture and its halvings


class PRT_PT_settings(SidebarPanel, bpy.types.Panel):
    """The settings of the next bake."""

    bl_label = "Settings"
    bl_parent_id = "PRT_PT_bake"

    def draw(self, context: bpy.types.Context) -> None:
        """Order, bounces and occlusion with what they cost, rays, seed, threads."""
        chosen = context.scene.prt
        layout = split(self.layout)
        layout.prop(chosen, "carrier")
        layout.prop(chosen, "order")
        if chosen.carrier != "TEXTURE":
            hint(layout, attributes_hint(chosen))
        bounces = layout.row()
        bounces.active = not chosen.all_bounces
        bounces.prop(chosen, "bounces")
        layout.prop(chosen, "all_bounces")
        if chosen.bounces or chosen.all_bounces:
            layout.prop(chosen, "keep_direct")
            if chosen.keep_direct:
                hint(layout, direct_hint(chosen))
        layout.prop(chosen, "reflections")
        if chosen.reflections:
            hint(layout, REFLECTIONS)
            layout.prop(chosen, "visibility_order")
            if int(chosen.visibility_order) and chosen.carrier != "TEXTURE":
                hint(layout, occlusion_hint(chosen))
        layout.prop(chosen, "quality")
        layout.prop(chosen, "rays" if chosen.quality == "RAYS" else "tolerance")
        layout.prop(chosen, "seed")
        layout.prop(chosen, "threads")


class PRT_PT_texture(SidebarPanel, bpy.types.Panel):
    """The textures of the next bake, where it goes to such."""

    bl_label = "Texture"
    bl_parent_id = "PRT_PT_settings"

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """Not for vertices alone."""
        return context.scene.prt.carrier != "VERTEX"

    def draw(self, context: bpy.types.Context) -> None:
        """Its size with what it costs, and where it goes."""
        chosen = context.scene.prt
        layout = split(self.layout)
        layout.prop(chosen, "size_by")
        if chosen.size_by == "RESOLUTION":
            layout.prop(chosen, "resolution")
            hint(layout, f"{megabytes(chosen):,.0f} MB on the graphics card")
        else:
            layout.prop(chosen, "texel_density")
        layout.prop(chosen, "shared_atlas")
        layout.prop(chosen, "padding_mip")
        layout.prop(chosen, "half")
        layout.prop(chosen, "pack_images")
        folder = layout.row()
        folder.active = not chosen.pack_images and bool(bpy.data.filepath)
        folder.prop(chosen, "image_folder")
        layout.prop(chosen, "engine_images")


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


def hint(layout: bpy.types.UILayout, text: str) -> None:
    """What a setting costs, in grey at the right."""
    row = layout.row()
    row.active = False
    row.alignment = "RIGHT"
    row.label(text=text)


def split(layout: bpy.types.UILayout) -> bpy.types.UILayout:
    """``layout`` with names on the left and values on the right."""
    layout.use_property_split = True
    layout.use_property_decorate = False
    return layout


def used_layout(chosen: bpy.types.PropertyGroup, channels: int = 1) -> Layout:
    """The most that a bake of grey surfaces stores, or with three ``channels`` one of coloured
    ones that light bounces off."""
    turns, seen = chosen.turns if chosen.residual else 0, int(chosen.visibility_order)
    seen *= chosen.reflections
    return Layout(chosen.order, channels, turns, chosen.peaks, seen)


def occlusion_hint(chosen: bpy.types.PropertyGroup) -> str:
    """What of the attributes are for the occlusion of reflections; it takes no ray."""
    whole = used_layout(chosen)
    more = len(whole.attributes) - len(replace(whole, visibility_order=0).attributes)
    return f"{more} attribute{'s' * (more != 1)} of them, and no more rays"


def attributes_hint(chosen: bpy.types.PropertyGroup) -> str:
    """What a bake takes of the attributes; with bounces, of coloured surfaces too."""
    grey = len(used_layout(chosen).attributes)
    whole = f"{grey} of EEVEE's {MAX_ATTRIBUTES} attributes"
    coloured = len(used_layout(chosen, 3).attributes)
    bounces = chosen.bounces or chosen.all_bounces
    return f"{whole}, {coloured} where colours bounce" if bounces else whole


def direct_hint(chosen: bpy.types.PropertyGroup) -> str:
    """What light without bounces takes beside the whole; EEVEE reads none of it, and no ray is
    traced for it."""
    count = len(used_layout(chosen).direct.attributes)
    attributes = f"{count} attributes that EEVEE does not read"
    return {
        "VERTEX": attributes,
        "TEXTURE": "a second image, which EEVEE does not read",
        "AUTO": f"{attributes}, or a second image",
    }[chosen.carrier] + ", no more rays"


def megabytes(chosen: bpy.types.PropertyGroup) -> float:
    """What one texture takes in memory at most: four floats a texel of every tile, and mips."""
    columns, rows = tile_grid(len(used_layout(chosen).attributes))
    return columns * rows * int(chosen.resolution) ** 2 * BYTES * MIPS / 1e6
