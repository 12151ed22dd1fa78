"""What a pixel of the viewer has to be, worked out from the .blend alone: rays through pixels meet
the evaluated meshes, and numpy evaluates what these hold.  Frames are Blender's, Z up."""

import bpy
import numpy as np
from gltf_laws import Y_UP
from prt_baker.addon import carrier, light_state, stamp
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


def expected(objects, camera, turned_world=0.0, turned_model=0.0):
    """The pixels (H) of a picture, bottom row first, that single triangles fill, and their exit
    radiance (H, 3); ``camera`` as the page tells it."""
    triangles, light = _triangles(objects, turned_world - turned_model)
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
    radiance, albedo = light
    seen = np.einsum("hk,hkc->hc", weights, radiance[index])
    return pixels, albedo[index] * np.maximum(seen, 0)


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


def _triangles(objects, turned):
    """Corners (T, 3, 3) of all triangles, their unclamped radiance (T, 3, 3) of a white surface
    under the scene's light ``turned`` by degrees, and their albedo (T, 3)."""
    depsgraph = bpy.context.evaluated_depsgraph_get()
    parts = [_of_object(obj, depsgraph, about_z(turned)) for obj in objects]
    corners, radiance, albedo = map(np.concatenate, zip(*parts, strict=True))
    return corners, (radiance, albedo)


def _of_object(obj, depsgraph, turn):
    made = stamp.read(obj)
    with carrier.evaluated_mesh(obj, depsgraph) as mesh:
        triangles = mesh.loop_triangles
        mesh.calc_loop_triangles()
        vertices = np.array([t.vertices[:] for t in triangles])
        loops = np.array([t.loops[:] for t in triangles])
        slots = np.array([t.material_index for t in triangles])
        positions = np.array([v.co[:] for v in mesh.vertices])
        columns = []
        for name in made.packing.attributes:
            data = mesh.attributes[name].data
            values = np.empty(4 * len(data), np.float32)
            data.foreach_get("color", values)
            columns.append(values.reshape(-1, 4))
    values = layouts.unpack(made.packing, np.concatenate(columns, axis=1))
    world = np.array(obj.matrix_world)
    positions = positions @ world[:3, :3].T + world[:3, 3]
    places = vertices if made.domain == "POINT" else loops
    return positions[vertices], _radiance(obj, made, values, turn)[places], _albedo(obj)[slots]


def _radiance(obj, made, values, turn):
    """(E, 3) of a white surface, not clamped."""
    state = light_state.read(bpy.context.scene)
    now = sh.rotate(state.radiance_sh, turn)
    peaks = state.peaks[: made.packing.lights]
    terms = residual.terms(now, state.baked_radiance_sh, made.packing.turns, peaks)
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
