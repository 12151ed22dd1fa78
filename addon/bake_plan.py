"""What a bake will store, before anything of it is known."""

from dataclasses import replace

import bpy

from . import world
from .prt import job as jobs
from .prt.errors import BakeError
from .prt.layout import Layout
from .prt.tiles import largest_size, tile_grid


def possible(
    owner: bpy.types.Scene, settings: jobs.Settings, hdri: str | None, channels: int
) -> tuple[Layout, Layout]:
    """The least and the most that a bake may store: a colour has nothing that an order leaves out,
    what is worth its float is only known in the end, and coloured surfaces take three channels."""
    simple = world.read_nodes(owner, bpy.context.evaluated_depsgraph_get()) if not hdri else None
    is_colour = simple is not None and simple.image is None
    turns = 0 if is_colour or not settings.residual else settings.turns
    seen = settings.visibility_order
    most = Layout(settings.order, channels, turns, 0 if is_colour else settings.peaks, seen)
    may_be_cut = settings.final_light or settings.tolerance > 0
    return replace(most, order=1 if may_be_cut else settings.order, lights=0), most


def largest_image(settings: jobs.Settings, most: Layout) -> int:
    """The side of the image of an atlas, at most, where it is not given by a density; BakeError
    where graphics cards take none so large."""
    count = len(most.attributes)
    side = 0 if settings.texel_density else settings.resolution
    if side > largest_size(count):
        raise BakeError(
            f"A texture of {side} x {side} with {most} is larger than graphics cards take: "
            f"choose at most {largest_size(count)}, or a lower order"
        )
    return side * max(tile_grid(count))


def settled(settings: jobs.Settings, most: Layout, *, reflects: bool) -> jobs.Settings:
    """``settings`` without what ``most`` has no room for, with reflections where any material
    ``reflects``; BakeError where they contradict each other."""
    residual = most.turns > 0
    if settings.bounces and most.lights and not residual:
        raise BakeError(
            "Peaks that bounce need Exact at This World: switch that on, or choose no peaks"
        )
    return replace(
        settings,
        residual=residual,
        peaks=most.lights,
        reflections=reflects,
        keep_direct=settings.keep_direct and settings.bounces != 0,
    )
