"""The error of a bake of Blender's own Suzanne at 256 rays."""

from dataclasses import replace

import bpy
import numpy as np
from prt_baker.addon import scene as scenes
from prt_baker.addon.prt import verify
from prt_baker.addon.prt.job import Settings
from prt_baker.addon.prt.surface import points
from prt_baker.addon.prt.tracing import rays, transfer


def trace(places, sky, count, seed):
    none = np.empty(0, np.int32)
    where = points.Points(
        places.origins.astype(np.float32), places.normals.astype(np.float32), none
    )
    out = np.empty((len(places.origins), 9), np.float32)
    for _ in transfer.trace_all(where, sky, Settings(rays=count, seed=seed), out):
        pass
    return out


def test_suzanne(scene):
    bpy.ops.mesh.primitive_monkey_add()
    suzanne = bpy.context.object
    suzanne.modifiers.new("Subdivision", "SUBSURF").levels = 3
    bpy.ops.object.shade_smooth()
    depsgraph = bpy.context.evaluated_depsgraph_get()
    (receiver,) = scenes.read_receivers(depsgraph, [suzanne])
    sky = rays.occlusion(*scenes.read_occluders(depsgraph)[:2])
    nothing = np.zeros((len(receiver.normals), 1, 9), np.float32)
    places = verify.random_surface_points(replace(receiver, transfer=nothing), 1000, 0)
    reference = trace(places, sky, 32768, 1)
    assert transfer.relative_rms(trace(places, sky, 256, 0), reference) < 0.008
