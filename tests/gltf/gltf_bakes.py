"""Made-up bakes on vertices, written as if they had just been baked."""

from dataclasses import replace

import bpy
import numpy as np
from prt_baker.addon import carrier, stamp, writeback
from prt_baker.addon.prt.layout import Layout
from prt_baker.addon.prt.results import ReceiverResult
from prt_baker.addon.scene import mesh_signature


def bake_by_hand(
    obj, *, order=3, channels=1, turns=0, lights=0, seen=0, domain="POINT", by_modifier=False,
    smooth=False, bent=False, direct=False,
):  # fmt: skip
    """Random transfer on ``obj``, written as if it had just been baked; residual and visibility
    tell which element they are of by its first coefficient.  ``smooth``: all of it changes slowly
    over each face, as it does in a bake, and ``bent`` is no linear function of the place.  With
    ``seen``, so many bands of what is seen; with ``direct``, other numbers for light that did not
    bounce."""
    bpy.context.view_layer.update()
    depsgraph = bpy.context.evaluated_depsgraph_get()
    layout = Layout(order, channels, turns, lights, seen)
    with carrier.evaluated_mesh(obj, depsgraph) as mesh:
        places = places_of(mesh, domain)
    if bent:
        places = np.concatenate([places, np.sin(3 * places), np.cos(5 * places)], axis=1)
    make = smooth_values if smooth else random_values
    arrays = make(places, layout)
    result = ReceiverResult(
        obj.name,
        arrays[0],
        np.arange(len(places), dtype=np.int32),
        *arrays[1:],
        visibility_sh=np.random.default_rng(7).normal(size=(len(places), seen**2)).astype("f4"),
    )
    made = make_stamp(obj, layout, domain, by_modifier)
    if direct:
        apart = make(0.7 * places, layout.direct)
        kept = ReceiverResult(obj.name, 0.6 * apart[0], result.element_points, 0.6 * apart[1])
        result, made = result.with_direct(kept), replace(made, direct=True, bounces=1)
    writeback.write(bpy.context.scene, [(obj, result, made)], layout)
    bpy.context.view_layer.update()
    return arrays[0]


def places_of(mesh, domain):
    """Where the elements of ``mesh`` are, (E, 3); corners lie a little off, by face."""
    points = np.array([vertex.co[:] for vertex in mesh.vertices]).reshape(-1, 3)
    if domain == "POINT":
        return points
    faces = np.repeat(np.arange(len(mesh.polygons)), [p.loop_total for p in mesh.polygons])
    return points[[loop.vertex_index for loop in mesh.loops]] + 0.2 * np.sin(faces)[:, None]


def random_values(places, layout):
    """Transfer, residual and visibility, each element with numbers of its own."""
    count = len(places)
    rng = np.random.default_rng(count + layout.order)
    transfer = rng.normal(size=(count, layout.channels, layout.order**2)).astype(np.float32)
    first = transfer[:, 0, :1]
    residual = [(k + 1) * first * (1, 2, 3) for k in range(layout.turns)]
    return (
        transfer,
        np.reshape(residual, (layout.turns, count, 3)).swapaxes(0, 1).astype(np.float32),
        first / (np.arange(layout.lights, dtype=np.float32) + 2),
    )


def smooth_values(places, layout):
    """The same as sums of slow functions of the place."""
    rng = np.random.default_rng(layout.order)
    shapes = ((layout.channels, layout.order**2), (layout.turns, 3), (layout.lights,))
    arrays = []
    for shape, size in zip(shapes, (0.06, 0.1, 0.3), strict=True):
        slopes = rng.normal(0, 0.3 * size, (places.shape[1], *shape))
        arrays.append(rng.normal(size, size, shape) + np.tensordot(places, slopes, 1))
    arrays[0][..., 0] += 0.3  # more light than shadow
    return [array.astype(np.float32) for array in arrays]


def make_stamp(obj, layout, domain, by_modifier):
    """What a bake of ``obj`` as it stands would say."""
    return stamp.blank(obj, layout, domain, by_modifier, mesh_signature(obj))
