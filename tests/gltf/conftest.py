"""An empty file, and objects baked in it with made-up transfer, so that a mistake shows."""

import bpy
import numpy as np
import pytest
from prt_baker.addon import carrier, light_state, stamp, writeback
from prt_baker.addon.prt.job import Peak
from prt_baker.addon.prt.layout import Layout
from prt_baker.addon.prt.results import ReceiverResult
from prt_baker.addon.scene import mesh_signature

PEAKS = (Peak((0.6, 0.0, 0.8), (30.0, 20.0, 10.0), 0.1), Peak((0.0, -1.0, 0.0), (1, 2, 3), 0.0))


@pytest.fixture
def scene():
    """The scene of an empty file, with a light."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    rng = np.random.default_rng(5)
    now, baked = rng.normal(size=(2, 25, 3))
    state = light_state.LightState("key", baked, now, baked, peaks=PEAKS)
    light_state.write(bpy.context.scene, state)
    return bpy.context.scene


@pytest.fixture
def bake(scene):
    """Bakes made-up values; returns the transfer (E, channels, n²) of the object's elements."""
    return bake_by_hand


@pytest.fixture
def out(tmp_path):
    return tmp_path / "scene.glb"


def bake_by_hand(obj, *, order=3, channels=1, turns=0, lights=0, domain="POINT", by_modifier=False):
    """Random transfer on ``obj``, written as if it had just been baked; residual and visibility
    tell which element they are of by its first coefficient."""
    bpy.context.view_layer.update()
    depsgraph = bpy.context.evaluated_depsgraph_get()
    layout = Layout(order, channels, turns, lights)
    with carrier.evaluated_mesh(obj, depsgraph) as mesh:
        count = len(mesh.vertices if domain == "POINT" else mesh.loops)
    rng = np.random.default_rng(count + order)
    transfer = rng.normal(size=(count, channels, order**2)).astype(np.float32)
    first = transfer[:, 0, :1]
    result = ReceiverResult(
        obj.name,
        transfer,
        np.arange(count, dtype=np.int32),
        np.stack([(k + 1) * first * (1, 2, 3) for k in range(turns)], 1).astype(np.float32)
        if turns
        else np.empty((count, 0, 3), np.float32),
        first / (np.arange(lights, dtype=np.float32) + 2),
    )
    made = make_stamp(obj, layout, domain, by_modifier)
    writeback.write(bpy.context.scene, [(obj, result, made)], layout)
    bpy.context.view_layer.update()
    return transfer


def make_stamp(obj, layout, domain, by_modifier):
    """What a bake of ``obj`` as it stands would say."""
    world = np.array(obj.matrix_world)
    return stamp.Stamp(
        order=layout.order,
        channels=layout.channels,
        layout=layout.slots,
        carrier="vertex",
        domain=domain,
        by_modifier=by_modifier,
        job_hash="",
        mesh_signature=mesh_signature(obj),
        matrix=tuple(world[:3, :3].ravel(order="F").tolist()),
        location=tuple(world[:3, 3].tolist()),
        points=0,
        rays=0,
        mrays_per_second=0.0,
    )
