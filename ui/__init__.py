"""The panels: they show properties and name operators, and compute nothing."""

import bpy

from .panel import PRT_PT_bake
from .result_panel import PRT_PT_light, PRT_PT_result
from .settings_panel import PRT_PT_exact, PRT_PT_settings, PRT_PT_texture

CLASSES = (PRT_PT_bake, PRT_PT_result, PRT_PT_light, PRT_PT_settings, PRT_PT_texture, PRT_PT_exact)


def register() -> None:
    """Give Blender the panels."""
    for cls in CLASSES:
        bpy.utils.register_class(cls)


def unregister() -> None:
    """Take them away."""
    for cls in reversed(CLASSES):
        bpy.utils.unregister_class(cls)
