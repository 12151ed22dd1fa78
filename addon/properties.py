"""The artist's settings, kept in the scene as ``scene.prt``."""

import bpy

from .prt.job import Settings

VERIFY_POINTS = 256  # of each object, traced again by brute force: enough to tell 1 % from 1.1 %


class PRT_PG_settings(bpy.types.PropertyGroup):
    """How finely to bake."""

    order: bpy.props.IntProperty(
        name="Order",
        description="Detail of the light: 3 holds soft light and skies, 5 holds sharper shadows "
        "and takes more memory",
        default=3,
        min=2,
        max=5,
        options=set(),
    )
    rays: bpy.props.IntProperty(
        name="Rays",
        description="Rays traced from every point: three times as many halve the noise",
        default=256,
        min=16,
        max=65536,
        soft_min=64,
        soft_max=4096,
        options=set(),
    )
    seed: bpy.props.IntProperty(
        name="Seed",
        description="Another seed gives other noise; the same seed gives the same bake",
        default=0,
        min=0,
        options=set(),
    )
    threads: bpy.props.IntProperty(
        name="Threads",
        description="Processor cores to bake on, 0 for all of them; changes nothing but the time",
        default=0,
        min=0,
        max=1024,
        soft_max=64,
        options=set(),
    )


def settings(scene: bpy.types.Scene, verify: bool = False) -> Settings:
    """What the artist chose, as a bake wants it; ``verify`` measures its error too."""
    chosen = scene.prt
    return Settings(
        order=chosen.order,
        rays=chosen.rays,
        seed=chosen.seed,
        threads=chosen.threads,
        verify_points=VERIFY_POINTS if verify else 0,
    )


def register() -> None:
    """Give every scene its settings."""
    bpy.utils.register_class(PRT_PG_settings)
    bpy.types.Scene.prt = bpy.props.PointerProperty(type=PRT_PG_settings, name="PRT Baker")


def unregister() -> None:
    """Take them away."""
    del bpy.types.Scene.prt
    bpy.utils.unregister_class(PRT_PG_settings)
