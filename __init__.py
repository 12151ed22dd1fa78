"""PRT Baker: bakes shadowed light that follows the HDRI, for EEVEE and glTF.

Importing this package needs no Blender; everything of Blender is imported when it is registered.
"""

from types import ModuleType
from typing import Any


def _parts() -> tuple[ModuleType, ...]:
    """What registers, in this order; each has ``register`` and ``unregister``."""
    from . import operators, ui
    from .addon import (
        cli,
        gltf_panel,
        live_light,
        live_materials,
        live_reflections,
        properties,
        stale,
    )

    parts = properties, gltf_panel, live_light, live_reflections, live_materials
    return *parts, stale, cli, operators, ui


def register() -> None:
    """Called by Blender when the extension is switched on."""
    for part in _parts():
        part.register()


def unregister() -> None:
    """Called by Blender when the extension is switched off."""
    for part in reversed(_parts()):
        part.unregister()


def __getattr__(name: str) -> Any:
    """Blender's glTF exporter and importer ask every enabled add-on's package for these classes,
    by name."""
    if name == "glTF2ExportUserExtension":
        from .addon.gltf import glTF2ExportUserExtension

        return glTF2ExportUserExtension
    if name == "glTF2ImportUserExtension":
        from .addon.gltf_import import glTF2ImportUserExtension

        return glTF2ImportUserExtension
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
