"""What a pixel of the viewer has to be, worked out from the .blend alone: rays through pixels meet
the evaluated meshes, and numpy evaluates what these hold.  Frames are Blender's, Z up."""

from collections.abc import Callable
from dataclasses import dataclass

import bpy
import numpy as np
from gltf_laws import Y_UP
from prt_baker.addon import atlas_images, carrier, light_state, stamp, uv_maps
from prt_baker.addon.prt import layout as layouts
from prt_baker.addon.prt import sh
from prt_baker.addon.prt.light import residual

WIDTH, HEIGHT = 480, 360
PIXELS = 600  # tried; those that one triangle fills are compared
GREY = 0.8  # a surface without material


def about_z(degrees):
    """The rotation (3, 3) by an angle about Z."""
    c, s = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
    return np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])


def expected(objects, camera, turned_world=0.0, turned_model=0.0, bounces=True):
    """The pixels (H) of a picture, bottom row first, that single triangles fill, and their exit
    radiance (H, 3); ``camera`` as the page tells it.  Without ``bounces``, of what was kept so."""
    depsgraph = bpy.context.evaluated_depsgraph_get()
    turn = about_z(turned_world - turned_model)
    parts = [_of_object(obj, depsgraph, turn, bounces) for obj in objects]
    triangles = np.concatenate([part.triangles for part in parts])
    rng = np.random.default_rng(1)
    pixels = rng.choice(WIDTH * HEIGHT, PIXELS, replace=False)
    centre = Y_UP.T @ np.array(camera["pivot"])
    back = about_z(-turned_model)
    index = weights = None
    for x, y in ((0.5, 0.5), (-0.1, -0.1), (1.1, -0.1), (-0.1, 1.1), (1.1, 1.1)):
        origin, directions = _rays(camera, pixels % WIDTH + x, pixels // WIDTH + y)
        origin = back @ (origin - centre) + centre
        met, shares = _meet(triangles, origin, directions @ back.T)
        if index is None:
            index, weights, kept = met, shares, met >= 0
        else:
            kept = met == index
        pixels, index, weights = pixels[kept], index[kept], weights[kept]
    starts = np.cumsum([0, *(len(part.triangles) for part in parts)])
    seen = np.empty((len(pixels), 3))
    for part, start in zip(parts, starts, strict=False):
        here = (index >= start) & (index < start + len(part.triangles))
        its = index[here] - start
        seen[here] = part.albedo[its] * np.maximum(part.radiance(its, weights[here]), 0)
    return pixels, seen


def _rays(camera, x, y):
    """Origin (3) and directions (P, 3) through places ``x`` and ``y`` in pixels."""
    matrix = np.reshape(camera["matrix"], (4, 4)).T
    tangent = np.tan(np.radians(camera["fov"]) / 2)
    right, up = (2 * x / WIDTH - 1) * tangent * WIDTH / HEIGHT, (2 * y / HEIGHT - 1) * tangent
    directions = np.stack([right, up, -np.ones_like(right)], axis=1) @ matrix[:3, :3].T
    return Y_UP.T @ matrix[:3, 3], directions @ Y_UP


def _meet(triangles, origin, directions):
    """The first triangle (P) of ``triangles`` (T, 3, 3) that each ray meets, -1 for none, and the
    weights (P, 3) of its corners: Möller and Trumbore 1997."""
    a, b, c = triangles[:, 0], triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0]
    from_a = origin - a
    q = np.cross(from_a, b)
    found, weights = np.full(len(directions), -1), np.zeros((len(directions), 3))
    for i, direction in enumerate(directions):
        p = np.cross(direction, c)
        with np.errstate(divide="ignore", invalid="ignore"):
            scale = 1 / np.einsum("tk,tk->t", p, b)
            u = scale * np.einsum("tk,tk->t", p, from_a)
            v = scale * (q @ direction)
            distance = scale * np.einsum("tk,tk->t", q, c)
            inside = (u >= 0) & (v >= 0) & (u + v <= 1) & (distance > 0)
        if inside.any():
            t = np.flatnonzero(inside)[np.argmin(distance[inside])]
            found[i], weights[i] = t, (1 - u[t] - v[t], u[t], v[t])
    return found, weights


@dataclass(frozen=True)
class Part:
    """One object: ``triangles`` (T, 3, 3), their ``albedo`` (T, 3), and the unclamped ``radiance``
    (H, 3) of a white surface at places of triangles (H) with the weights (H, 3) of their corners.
    """

    triangles: np.ndarray
    albedo: np.ndarray
    radiance: Callable[[np.ndarray, np.ndarray], np.ndarray]


def _of_object(obj, depsgraph, turn, bounces):
    made = stamp.read(obj)
    prefix = "_PRT_" if bounces or not made.direct else "_PRT_DIRECT_"
    packing = made.sets[prefix]
    with carrier.evaluated_mesh(obj, depsgraph) as mesh:
        triangles = mesh.loop_triangles
        mesh.calc_loop_triangles()
        vertices = np.array([t.vertices[:] for t in triangles])
        loops = np.array([t.loops[:] for t in triangles])
        slots = np.array([t.material_index for t in triangles])
        positions = np.array([v.co[:] for v in mesh.vertices])
        uvs = uv_maps.read(mesh) if made.in_atlas else None
        columns = [] if made.in_atlas else [_values(mesh, n) for n in packing.called(prefix)]
    world = np.array(obj.matrix_world)
    positions = (positions @ world[:3, :3].T + world[:3, 3])[vertices]
    if made.in_atlas:
        image = atlas_images.both(stamp.image_of(obj))[prefix != "_PRT_"]
        atlas = atlas_images.columns(image, len(packing.attributes))

        def radiance(index, weights):
            at = np.einsum("hk,hkc->hc", weights, uvs[loops[index]])
            values = layouts.unpack(packing, bilinear(atlas, at).astype(np.float32))
            return _radiance(obj, packing, values, turn)

        return Part(positions, _albedo(obj)[slots], radiance)
    values = layouts.unpack(packing, np.concatenate(columns, axis=1))
    corners = _radiance(obj, packing, values, turn)[vertices if made.domain == "POINT" else loops]
    return Part(
        positions,
        _albedo(obj)[slots],
        lambda index, weights: np.einsum("hk,hkc->hc", weights, corners[index]),
    )


def _values(mesh, name):
    data = mesh.attributes[name].data
    values = np.empty(4 * len(data), np.float32)
    data.foreach_get("color", values)
    return values.reshape(-1, 4)


def bilinear(image, uvs):
    """What a read of ``image`` (N, N, K), row 0 at the bottom, finds at ``uvs`` (H, 2)."""
    place = np.clip(uvs * len(image) - 0.5, 0, len(image) - 1)
    low = np.minimum(place.astype(int), len(image) - 2)
    (u, v), (c, r) = (place - low).T[:, :, None], low.T
    below = (1 - u) * image[r, c] + u * image[r, c + 1]
    above = (1 - u) * image[r + 1, c] + u * image[r + 1, c + 1]
    return (1 - v) * below + v * above


def _radiance(obj, packing, values, turn):
    """(E, 3) of a white surface, not clamped."""
    state = light_state.read(bpy.context.scene)
    now = sh.rotate(state.radiance_sh, turn)
    peaks = state.peaks[: packing.lights]
    terms = residual.terms(now, state.baked_radiance_sh, packing.turns, peaks)
    return residual.shaded(values.transfer, now) + residual.beyond(values, terms, stamp.share(obj))


def _albedo(obj):
    """(slots, 3)."""
    return np.array([_colour(slot.material) for slot in obj.material_slots] or [[GREY] * 3])


def _colour(material):
    if material is None:
        return [GREY] * 3
    shaders = (n for n in material.node_tree.nodes if n.type == "BSDF_PRINCIPLED")
    shader = next(shaders, None)
    return shader.inputs["Base Color"].default_value[:3] if shader else [GREY] * 3


def encoded(linear):
    """sRGB, 0 to 255, not rounded."""
    x = np.clip(linear, 0, 1)
    return 255 * np.where(x <= 0.0031308, 12.92 * x, 1.055 * x ** (1 / 2.4) - 0.055)
