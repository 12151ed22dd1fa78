"""Made-up bakes in textures, to be written without an engine."""

from dataclasses import replace

import bpy
import numpy as np
from bakes import stamp_for
from prt_baker.addon import atlas_images, carrier, writeback
from prt_baker.addon.prt import layout as layouts
from prt_baker.addon.prt.files.atlases import write_tiles
from prt_baker.addon.prt.results import InAtlas, ReceiverResult

NOTHING = np.empty(0, np.int32)


def plane_uvs(obj):
    """UVs of every corner by its place in the plane, from the lower left of a unit square."""
    with carrier.evaluated_mesh(obj, bpy.context.evaluated_depsgraph_get()) as mesh:
        places = [tuple(mesh.vertices[loop.vertex_index].co.xy) for loop in mesh.loops]
    return np.array(places, np.float32)


def random_values(layout, count, seed=0):
    """Transfer, residual and visibility of ``count`` points."""
    rng = np.random.default_rng(seed)
    transfer = rng.normal(0, 0.3, (count, layout.channels, layout.order**2))
    transfer[:, :, 0] = rng.uniform(0.8, 1.2, (count, layout.channels))
    residual = rng.normal(0, 0.1, (count, layout.turns, 3))
    visibility = rng.uniform(0, 1, (count, layout.lights))
    return [values.astype(np.float32) for values in (transfer, residual, visibility)]


def smooth(values, size):
    """``values`` (size², ...) with a twentieth of their differences from texel to texel: a graphics
    card rounds a read's weights to 1/256."""
    image = values.reshape(size, size, -1)
    mean = image.mean(axis=(0, 1))
    wave = np.cos(np.arange(size) / size * 3)[:, None, None] * image[0]
    return (mean + 0.05 * (image - mean) + 0.05 * wave).reshape(values.shape).astype(np.float32)


def atlas(folder, layout, size, *, seed=0, margin=0.5, name="PRT Atlas"):
    """An image with random values for every texel, and these (transfer, residual, visibility)."""
    values = [smooth(each, size) for each in random_values(layout, size * size, seed)]
    names = [slot for slot in layout.slots if slot]
    packed = layouts.pack(layout, layouts.Values(*values))[:, : len(names)]
    path = folder / f"{name} {seed}.exr"
    write_tiles(
        path, packed.reshape(size, size, -1), names, half=False, metadata={"prtBaker": "test"}
    )
    image = atlas_images.load(path, name, atlas_images.Atlas(size, margin, "test"))
    return image, values


def bake(obj, layout, size, uvs=None, number=0):
    """``obj`` in atlas ``number``, with ``uvs`` (C, 2)."""
    uvs = plane_uvs(obj) if uvs is None else uvs
    values = random_values(layout, 4)
    result = ReceiverResult(
        obj.name, values[0], NOTHING, values[1], values[2], InAtlas(number, uvs)
    )
    mark = replace(stamp_for(obj, layout, "CORNER"), carrier="texture", atlas_size=size)
    return obj, result, mark


def write(scene, folder, layout, *objects, size=8, seed=0):
    """Bake ``objects`` into one atlas; what was written, the image, and its values."""
    image, values = atlas(folder, layout, size, seed=seed)
    baked = [bake(obj, layout, size) for obj in objects]
    writeback.write(scene, baked, layout, [image])
    return baked, image, values


def bilinear(image, uvs):
    """What a read of ``image`` (N, N, K) finds at ``uvs`` (..., 2), edges extended."""
    size = len(image)
    place = np.clip(uvs * size - 0.5, 0, size - 1)
    low = np.minimum(np.floor(place).astype(int), size - 2)
    (u, v), (c, r) = np.moveaxis(place - low, -1, 0), np.moveaxis(low, -1, 0)
    u, v = u[..., None], v[..., None]
    below = (1 - u) * image[r, c] + u * image[r, c + 1]
    above = (1 - u) * image[r + 1, c] + u * image[r + 1, c + 1]
    return (1 - v) * below + v * above
