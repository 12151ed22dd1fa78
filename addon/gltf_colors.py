"""Which COLOR_n of a baked mesh are the artist's.

Our attributes are colour attributes in Blender, so the exporter writes clipped copies of them too,
and no hook can keep it from that.  One case stays: with "Export All Vertex Colors" off, a mesh
without a material loses its COLOR_0, because the default material that shows the bake reads none.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import bpy
import numpy as np

from . import default_surface
from .gltf_attributes import Accessors, is_ours, values_of

UNSIGNED_SHORT = 5123
WHITE = ""  # the exporter's own COLOR_0, where the material reads no colour


@dataclass(frozen=True)
class Colors:
    """The colour attributes of one mesh.

    ``names`` are all of them in order, ``first`` the one that the artist's settings put first.
    ``wanted`` are those that the exporter would write of a mesh without a material, in its order;
    None where the artist has given the mesh one.
    """

    names: Sequence[str]
    first: str
    wanted: Sequence[str] | None

    def of_the_artist(self, attributes: Accessors) -> Accessors:
        """``attributes`` with the COLOR_n that the exporter would write if we were not there."""
        colors = {name: a for name, a in attributes.items() if name.startswith("COLOR_")}
        written = [colors[name] for name in sorted(colors, key=lambda name: int(name[6:]))]
        order = self._order(attributes, written)
        named = dict(zip(order, written, strict=False))
        theirs = [name for name in order if name in named and not is_ours(name)]
        if all(map(is_ours, self.names)):
            theirs = []
        elif self.wanted is not None:
            theirs = [name for name in self.wanted if name in named]
        others = {name: a for name, a in attributes.items() if name not in colors}
        return others | {f"COLOR_{n}": named[name] for n, name in enumerate(theirs)}

    def _order(self, attributes: Accessors, written: list[Any]) -> list[str]:
        """The colour attribute that each of ``written`` came from."""
        for order in self._possible_orders(len(written)):
            pairs = zip(written, order, strict=False)
            if all(_is_copy(a, attributes.get(name)) for a, name in pairs if is_ours(name)):
                return order
        return [name for name in self.names if not is_ours(name)]

    def _possible_orders(self, count: int) -> Iterator[list[str]]:
        """First comes the colour that the material reads, or a white one; the rest follow as they
        lie in the mesh."""
        if count > len(self.names):
            yield [WHITE, *self.names]
        for first in sorted(self.names, key=lambda name: (name != self.first, is_ours(name))):
            yield [first, *(name for name in self.names if name != first)]


def of(
    mesh: bpy.types.Mesh,
    materials: Sequence[bpy.types.Material | None],
    settings: dict[str, Any],
) -> Colors:
    """The colours of ``mesh``, which is exported with ``materials``."""
    attributes = mesh.color_attributes
    names = [attribute.name for attribute in attributes]
    index = attributes.render_color_index
    render = names[index] if index >= 0 else ""
    first = settings.get("gltf_vertex_color_name") or render  # Blender 4.3 has no such setting
    if not materials or any(m and not default_surface.is_ours(m) for m in materials):
        return Colors(names, first, None)
    wanted = sorted((name for name in names if not is_ours(name)), key=lambda name: name != first)
    if not settings["gltf_active_vertex_color_when_no_material"]:
        wanted = []
    return Colors(names, first, wanted if settings["gltf_all_vertex_colors"] else wanted[:1])


def _is_copy(color: Any, ours: Any) -> bool:
    """Did the exporter make ``color`` of our attribute?"""
    if ours is None:
        return False
    values = values_of(ours)
    if color.component_type == UNSIGNED_SHORT:
        with np.errstate(invalid="ignore"):
            scaled = np.clip(values, 0, 1) * np.float32(65535) + np.float32(0.5)
            expected = scaled.astype(np.uint16)
    else:
        expected = values[:, :3]
    return bool(color.buffer_view.data == expected.tobytes())
