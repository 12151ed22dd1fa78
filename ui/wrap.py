"""Sentences that are longer than a sidebar is wide."""

import textwrap

import bpy

CHARACTER = 6.4  # pixels that a letter takes, about, at 72 dpi and a scale of 1


def box(layout: bpy.types.UILayout, context: bpy.types.Context, icon: str, sentence: str) -> None:
    """``sentence`` in a box, in as many lines as it needs."""
    column = layout.box().column(align=True)
    for number, line in enumerate(textwrap.wrap(sentence, letters(context, 70))):
        column.label(text=line, icon=icon if number == 0 else "BLANK1")


def lines(layout: bpy.types.UILayout, context: bpy.types.Context, sentence: str) -> None:
    """``sentence`` without a box, in as many lines as it needs."""
    whole = sentence.replace(" %", "\u00a0%")  # a number keeps its unit
    for line in textwrap.wrap(whole, letters(context, 50), subsequent_indent="   "):
        layout.label(text=line.replace("\u00a0", " "))


def letters(context: bpy.types.Context, margin: int) -> int:
    """How many letters fit into the sidebar but for a ``margin`` in pixels."""
    width = context.region.width / context.preferences.system.ui_scale
    return max(12, int((width - margin) / CHARACTER))
