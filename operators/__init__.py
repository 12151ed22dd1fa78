"""What the artist can do: one verb a file, and one driver for the long ones."""

import bpy

from . import job_driver
from .bake import PRT_OT_bake
from .cancel import PRT_OT_cancel
from .remove_bake import PRT_OT_remove_bake
from .update_light import PRT_OT_update_light
from .verify import PRT_OT_verify

CLASSES = (PRT_OT_bake, PRT_OT_cancel, PRT_OT_update_light, PRT_OT_verify, PRT_OT_remove_bake)


def register() -> None:
    """Give Blender the operators."""
    for cls in CLASSES:
        bpy.utils.register_class(cls)


def unregister() -> None:
    """End what runs, and take the operators away."""
    job_driver.stop()
    for cls in reversed(CLASSES):
        bpy.utils.unregister_class(cls)
