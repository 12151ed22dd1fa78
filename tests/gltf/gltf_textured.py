"""Bakes in a made-up atlas, written as if they had just been baked."""

from dataclasses import replace

import bpy
import numpy as np
from gltf_bakes import make_stamp, smooth_values
from prt_baker.addon import atlas_images, carrier, writeback
from prt_baker.addon.prt import layout as layouts
from prt_baker.addon.prt.files.atlases import write_tiles
from prt_baker.addon.prt.layout import Layout
from prt_baker.addon.prt.results import InAtlas, ReceiverResult

ORDER_3 = Layout(3, turns=1)
NOTHING = np.empty(0, np.int32)


def bake_in_texture(folder, objects, layout=ORDER_3, size=64, *, own_uvs=False, direct=False):
    """Slow functions of the place in an atlas that ``objects`` share, each face in a cell of its
    own; the atlas (N, N, 4 k), row 0 at the bottom.  With ``direct``, a second one of other
    numbers for light that did not bounce."""
    values = atlas_values(layout, size)
    image = image_of(folder / f"{objects[0].name}.exr", layout, values)
    if direct:
        apart = 0.6 * atlas_values(layout.direct, size)[::-1]
        path = folder / f"{objects[0].name}_direct.exr"
        atlas_images.set_direct(image, image_of(path, layout.direct, apart))
    bpy.context.view_layer.update()
    depsgraph = bpy.context.evaluated_depsgraph_get()
    faces = [face_sizes(obj, depsgraph) for obj in objects]
    starts = np.cumsum([0, *map(len, faces)])
    baked = []
    for obj, sizes, start in zip(objects, faces, starts, strict=False):
        uvs = cells(sizes, start, starts[-1])
        by_modifier = carrier.needs_modifier(obj, depsgraph)
        mark = make_stamp(obj, layout, "CORNER", by_modifier)
        mark = replace(mark, carrier="texture", atlas_size=size, own_uvs=own_uvs)
        mark = replace(mark, direct=direct, bounces=int(direct))
        empty = vars(layouts.unpack(layout, np.empty((0, len(layout.slots)), np.float32)))
        result = ReceiverResult(obj.name, element_points=NOTHING, in_atlas=InAtlas(0, uvs), **empty)
        baked.append((obj, result, mark))
    writeback.write(bpy.context.scene, baked, layout, [image])
    bpy.context.view_layer.update()
    return values


def image_of(path, layout, values):
    """An atlas of ``values`` (N, N, 4 k) of ``layout`` in a file at ``path``."""
    names = [slot for slot in layout.slots if slot]
    write_tiles(path, values[..., : len(names)], names, half=False, metadata={"prtBaker": "test"})
    return atlas_images.load(path, "PRT Atlas", atlas_images.Atlas(len(values), 0.5, "test"))


def atlas_values(layout, size):
    """Values (N, N, 4 k) that change slowly, by texel."""
    at = (np.arange(size) + 0.5) / size
    v, u = np.meshgrid(at, at, indexing="ij")
    places = np.stack([np.sin(3 * u + v), np.cos(2 * v - u), u * v], axis=2).reshape(-1, 3)
    arrays = smooth_values(places, layout)
    seen = np.tile(places, (1, 9))[:, : layout.visibility_order**2].astype(np.float32)
    return layouts.pack(layout, layouts.Values(*arrays, seen)).reshape(size, size, -1)


def face_sizes(obj, depsgraph):
    """How many corners every face has."""
    with carrier.evaluated_mesh(obj, depsgraph) as mesh:
        return np.array([polygon.loop_total for polygon in mesh.polygons])


def cells(sizes, start, count):
    """UVs (C, 2) of faces of ``sizes`` corners, on circles in a grid of cells for ``count`` faces,
    of which these are ``start`` and the following ones."""
    across = int(np.ceil(np.sqrt(count)))
    face = np.repeat(np.arange(len(sizes)), sizes)
    corner = np.arange(len(face)) - np.repeat(np.cumsum(sizes) - sizes, sizes)
    angle = 2 * np.pi * corner / sizes[face] + 0.4
    middle = np.stack([(face + start) % across, (face + start) // across], axis=1) + 0.5
    return ((middle + 0.4 * np.stack([np.cos(angle), np.sin(angle)], axis=1)) / across).astype(
        np.float32
    )
