"""What a bake stores on a mesh: colour attributes of four float32 each, or the UV map of an atlas.

Nothing of the artist's changes with them: neither which attribute or UV map is active, nor which
colour or UV map is shown or rendered.
"""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager

import bpy
import numpy as np
import numpy.typing as npt

from . import carrier_nodes, uv_maps
from .prt import layout as layouts
from .prt.errors import BakeError
from .prt.layout import DIRECT, PREFIX, Layout
from .prt.results import ReceiverResult
from .stamp import Stamp

Values = npt.NDArray[np.float32]
Stored = dict[str, tuple[str, Values]]
TYPES = {4: ("FLOAT_COLOR", "color"), 2: ("FLOAT2", "vector")}  # by numbers an element


def names(mesh: bpy.types.Mesh) -> list[str]:
    """The baked attributes of ``mesh``, our UV maps included."""
    found = [attribute.name for attribute in mesh.attributes if attribute.name.startswith(PREFIX)]
    found += [uv_maps.EMPTY] * uv_maps.has_empty(mesh)
    return found + [uv_maps.NAME] * uv_maps.is_ours(mesh)


def write(mesh: bpy.types.Mesh, layout: Layout, domain: str, values: Values) -> None:
    """Give ``mesh`` the values (E, 4 k) of ``layout``, instead of what was baked before."""
    put(mesh, split(layout.attributes, domain, values))


def split(names: Sequence[str], domain: str, values: Values) -> Stored:
    """The values (E, 4 k) of the attributes ``names``, as ``put`` takes them."""
    columns = values.reshape(len(values), -1, 4)
    return {name: (domain, columns[:, k]) for k, name in enumerate(names)}


def of_result(result: ReceiverResult, layout: Layout, domain: str) -> Stored:
    """What ``result`` has at every element, as ``put`` takes it: in ``layout``, and what was kept
    without bounces."""
    values = layouts.pack(layout, layouts.at_elements(result))
    stored = split(layout.attributes, domain, values)
    if result.direct is not None:
        direct = layouts.pack(layout.direct, layouts.at_elements(result.direct))
        stored |= split(layout.direct.called(DIRECT), domain, direct)
    return stored


def with_uvs(uvs: Values, mesh: bpy.types.Mesh) -> Stored:
    """The UV map ``uvs`` (C, 2) of an atlas, as ``put`` takes it, for what shows ``mesh``."""
    maps: Stored = {} if uv_maps.has_others(mesh) else {uv_maps.EMPTY: ("CORNER", 0 * uvs)}
    return {**maps, uv_maps.NAME: ("CORNER", uvs)}


def put(mesh: bpy.types.Mesh, stored: Stored) -> None:
    """Make ``stored``, name to domain and values (E, 4 or 2), the baked attributes of ``mesh``."""
    with _kept_active(mesh):
        for name in names(mesh):
            mesh.attributes.remove(mesh.attributes[name])
        if uv_maps.TAG in mesh:
            del mesh[uv_maps.TAG]
        for name, (domain, values) in stored.items():
            flat = np.ascontiguousarray(values, np.float32).ravel()
            kind, component = TYPES[values.shape[1]]
            attribute = mesh.attributes.new(name, kind, domain)
            attribute.data.foreach_set(component, flat)
            if name == uv_maps.NAME:
                mesh[uv_maps.TAG] = uv_maps.digest(values)
    mesh.update_tag()


def take(mesh: bpy.types.Mesh) -> Stored:
    """A copy of the baked attributes of ``mesh``, as ``put`` takes them."""
    return {name: (mesh.attributes[name].domain, _values(mesh, name)) for name in names(mesh)}


def remove(mesh: bpy.types.Mesh) -> None:
    """Take every baked attribute away."""
    if names(mesh):
        put(mesh, {})


def read(obj: bpy.types.Object, stamp: Stamp) -> layouts.Values:
    """What every vertex or corner that was baked holds."""
    holder = carrier_nodes.carrier_of(obj) if stamp.by_modifier else obj
    layout = stamp.packing
    if holder is None or not set(layout.attributes) <= set(names(holder.data)):
        raise BakeError(f"The baked attributes of {obj.name!r} are gone: bake it again")
    columns = [_values(holder.data, name) for name in layout.attributes]
    return layouts.unpack(layout, np.concatenate(columns, axis=1))


def _values(mesh: bpy.types.Mesh, name: str) -> Values:
    """Values (E, 4) of one colour attribute, or (C, 2) of a UV map."""
    data = mesh.attributes[name].data
    width = 2 if name in {uv_maps.EMPTY, uv_maps.NAME} else 4
    values = np.empty(len(data) * width, np.float32)
    data.foreach_get(TYPES[width][1], values)
    return values.reshape(-1, width)


@contextmanager
def _kept_active(mesh: bpy.types.Mesh) -> Iterator[None]:
    """Adding and removing attributes inside leaves the active ones as they are, by name; of our UV
    maps, where there are no others, it is the empty one."""
    attributes, layers = mesh.attributes, mesh.uv_layers
    active = attributes.active.name if attributes.active else ""
    edited = layers.active.name if layers.active else ""
    shown_uvs = next((layer.name for layer in layers if layer.active_render), "")
    colours = [attributes.active_color_name or "", attributes.default_color_name or ""]
    shown, rendered = ("" if name.startswith(PREFIX) else name for name in colours)
    yield
    attributes.active_color_name = shown
    attributes.default_color_name = rendered
    if active in attributes:
        attributes.active = attributes[active]
    for name in (edited, uv_maps.EMPTY):
        if name in layers:
            layers.active = layers[name]
            break
    for name in (shown_uvs, uv_maps.EMPTY):
        if name in layers:
            layers[name].active_render = True
            break
