"""The light that a reader of the file sees is the light of the .blend."""

import re
from math import radians

import bpy
import numpy as np
from mathutils import Euler, Matrix
from prt_baker.addon import light_state
from prt_baker.addon.prt import sh

Y_UP = np.array(Matrix(((1, 0, 0), (0, 0, 1), (0, -1, 0))))

SHORT, PICTURE = 65534, 131070  # what scales are divided by for the largest error stated

TURN = np.array(Euler((0.3, -0.5, radians(40))).to_matrix())


def element_values(glb, name, transfer):
    """The file's transfer and the .blend's, of the same elements: T0 tells which, no turn changes
    it, and it is float32 in both."""
    found = glb.transfer(name)
    order = np.argsort(transfer[:, 0, 0])
    places = np.searchsorted(transfer[order, 0, 0], found[:, 0, 0])
    expected = transfer[order[places]]
    np.testing.assert_array_equal(found[..., 0], expected[..., 0])
    assert set(order[places]) == set(range(len(transfer))), "an element is missing in the file"
    return found, expected


def light_of(glb, order):
    extras = glb.document["scenes"][0]["extras"]["prt_light"]
    assert extras["order"] == 5
    return np.array(extras["radiance_sh"])[: order**2]


def exit_radiance(transfer, light):
    """(E, 3) of a white surface."""
    return np.einsum("eci,ic->ec", np.broadcast_to(transfer, (len(transfer), 3, len(light))), light)


def assert_same_light(glb, name, transfer, now, turned):
    """``now``: the world 3x3 that a viewer gives the node; ``turned``: by how much the .blend's
    object is turned, Z up."""
    order = round(transfer.shape[-1] ** 0.5)
    state = light_state.read(bpy.context.scene).radiance_sh[: order**2]
    found, expected = element_values(glb, name, transfer)
    baked = np.reshape(glb.prt(name)["matrix"], (3, 3)).T
    delta = now @ np.linalg.inv(baked)
    np.testing.assert_allclose(delta @ delta.T, np.eye(3), atol=1e-5)
    seen = exit_radiance(found, sh.rotate(light_of(glb, order), delta.T))
    truth = exit_radiance(expected, sh.rotate(state, turned.T))
    np.testing.assert_allclose(seen, truth, atol=1e-5)


def stated_errors(prt, slots, steps):
    """What docs/gltf.md says that floats ``slots`` of ``prt`` may be off in Blender's axes: a float
    that has no direction scale / ``steps``; a coefficient its share of the errors of its band."""
    scale = dict(zip(prt["layout"], prt["scale"], strict=True))
    shares = np.abs(sh.rotation_matrix(Y_UP.T, 5))
    errors = np.array([_error(slot, scale, shares) for slot in slots]) / steps
    assert errors.any()
    return errors


def _error(slot, scale, shares):
    kind, index, channel = re.fullmatch(r"([TRSV]?)(\d*)(.*)", slot).groups()
    if kind not in {"T", "V"}:
        return scale.get(slot, 0)
    row = shares[int(index)]
    return sum(row[k] * scale[f"{kind}{k}{channel}"] for k in np.flatnonzero(row > 1e-9))
