"""Scenes of Blender at the ends of what it allows, through a whole bake."""

import json
from dataclasses import replace

import bmesh
import bpy
import numpy as np
import OpenEXR
import pytest
from mathutils import Matrix
from meshes import MIRRORED, SHEARED, ball, cube, mesh_of, place, receiver_of
from prt_baker.addon import bake
from prt_baker.addon.prt import sh
from prt_baker.addon.prt.errors import BakeError
from prt_baker.addon.prt.job import Settings
from prt_baker.addon.prt.steps import value_of
from prt_baker.addon.prt.tracing.transfer import relative_rms
from worlds import environment, new_world

pytestmark = pytest.mark.filterwarnings("error::RuntimeWarning")

FEW = Settings(rays=64, seed=5, threads=1, fit=False, residual=False)
FULL = float(sh.basis([0.0, 0.0, 1.0], 1)[0])


def baked(scene, *objects, world=True, rays=64):
    """The report of a bake, under a grey world unless there is another."""
    if world:
        new_world(scene)
    bpy.context.view_layer.update()
    settings = replace(FEW, rays=rays)
    return value_of(bake.bake(scene.name, [obj.name for obj in objects], settings))


def held(obj):
    """The transfer (E, 9) that the attributes of ``obj`` show, by its stamp's layout."""
    slots = json.loads(obj["prt_stamp"])["layout"]
    values = []
    for k in range(len(slots) // 4):
        data = obj.data.attributes[f"_PRT_{k}"].data
        four = np.empty(4 * len(data), np.float32)
        data.foreach_get("color", four)
        values.append(four.reshape(-1, 4))
    together = np.concatenate(values, axis=1)
    return np.stack([together[:, slots.index(f"T{i}")] for i in range(9)], axis=1)


def open_error(obj):
    """The largest difference to an open sky about the normals that Blender shades with."""
    normals = receiver_of(obj).normals.astype(np.float64)
    return float(np.abs(held(obj) - sh.open_transfer(normals, 3)).max())


def still_life(scene, matrix):
    """A floor and a ball above it, put somewhere by ``matrix``: what the floor shows."""
    floor = place(mesh_of(bmesh.ops.create_grid, "Floor", x_segments=8, y_segments=8, size=2))
    above = place(ball(), "Ball", Matrix.Translation((0.25, -0.5, 1.5)))
    above.parent.matrix_basis = matrix
    floor.matrix_world = matrix
    baked(scene, floor, above, rays=1024)
    return held(floor)


PLACES = {
    "1e-4": Matrix.Scale(1e-4, 4),
    "1e5": Matrix.Scale(1e5, 4),
    "1e6 away": Matrix.Translation((1e6, -1e6, 1e6)),
}


def test_scale_and_place_change_nothing(scene, record_property):
    """A floor under a ball at scales 1e-4 and 1e5, and 1e6 from the origin (where Blender itself
    places an object to 1/16): the floor shows what it shows at the origin, to 3e-3 (RMS), the
    noise of rays that rounding gives to other points."""
    expected = still_life(scene, Matrix())
    assert (expected[:, 0] / FULL).min() < 0.9, "the ball must shadow the floor"
    for name, matrix in PLACES.items():
        bpy.ops.wm.read_factory_settings(use_empty=True)
        error = relative_rms(still_life(bpy.context.scene, matrix), expected)
        record_property("measured", error)
        assert error < 3e-3, name


def test_the_largest_scene(scene, record_property):
    """The same 4e11 across: the same, to 3e-3 (RMS). A cube of 2e12, beyond what float32 can
    trace: refused in one sentence."""
    expected = still_life(scene, Matrix())
    bpy.ops.wm.read_factory_settings(use_empty=True)
    error = relative_rms(still_life(bpy.context.scene, Matrix.Scale(1e11, 4)), expected)
    record_property("measured", error)
    assert error < 3e-3
    beyond = place(cube(), matrix=Matrix.Scale(2e12, 4))
    with pytest.raises(BakeError, match="too far away"):
        baked(bpy.context.scene, beyond)


def test_normals_at_every_scale(scene, record_property):
    """Shading normals of a mirrored, unevenly scaled ball at scales 1e-12 to 1e11: those at scale
    1, to 1e-6."""
    mesh = ball()
    expected = receiver_of(place(mesh, matrix=MIRRORED)).normals
    for scale in (1e-12, 1e-10, 1e-4, 1e5, 1e10, 1e11):
        got = receiver_of(place(mesh, matrix=MIRRORED @ Matrix.Scale(scale, 4))).normals
        error = np.abs(got - expected).max()
        record_property("measured", error)
        assert error < 1e-6, scale


def test_negative_and_sheared_scales(scene, record_property):
    """A cube and a smooth ball, mirrored, sheared and with all axes negative: convex, so all of the
    sky about Blender's normals, to 1e-5."""
    negative = Matrix.Diagonal((-1, -1, -1, 1))
    objects = [
        place(make(), matrix=Matrix.Translation((1e4 * k, 0, 0)) @ matrix)
        for k, (make, matrix) in enumerate(
            (make, matrix) for make in (cube, ball) for matrix in (MIRRORED, SHEARED, negative)
        )
    ]
    for obj in objects:
        for other in objects:
            other.hide_render = other != obj
        baked(scene, obj)
        error = open_error(obj)
        record_property("measured", error)
        assert error < 1e-5


def test_an_object_flattened_to_a_sheet(scene, record_property):
    """A ball scaled to nothing along Z: its two coincident sides see all of the sky above or below
    them, to 1e-5."""
    flat = place(ball(smooth=False), matrix=Matrix.Diagonal((1, 1, 0, 1)))
    receiver = receiver_of(flat)
    baked(scene, flat)
    has_area = np.zeros(len(receiver.normals), bool)
    has_area[receiver.triangle_corners] = True
    expected = sh.open_transfer(receiver.normals.astype(np.float64), 3)
    error = np.abs(held(flat) - expected)[has_area].max()
    record_property("measured", error)
    assert error < 1e-5
    assert has_area.mean() > 0.9


def test_flipped_faces(scene, record_property):
    """A cube with one face flipped, and one wholly inside out: the flipped faces are dark, the rest
    sees all of its sky, to 1e-5."""
    mixed = place(cube("Mixed"), "Mixed")
    mixed.data.polygons[0].flip()
    mixed.data.update()
    baked(scene, mixed)
    normals = receiver_of(mixed).normals.astype(np.float64)
    wrong = np.zeros(len(normals), bool)
    wrong[mixed.data.polygons[0].loop_indices] = True
    error = np.abs(held(mixed) - sh.open_transfer(normals, 3))[~wrong].max()
    record_property("measured", error)
    assert error < 1e-5
    assert not held(mixed)[wrong].any()
    bpy.data.objects.remove(mixed)
    inside_out = place(cube("Inside Out"), "Inside Out")
    inside_out.data.flip_normals()
    baked(scene, inside_out)
    assert not held(inside_out).any()


def non_manifold():
    """A cube with a fin on an edge, a doubled face, faces without area, a loose edge and vertex."""
    mesh = bpy.data.meshes.new("Non-Manifold")
    box = cube("Source")
    vertices = [tuple(v.co) for v in box.vertices]
    faces = [tuple(p.vertices) for p in box.polygons]
    first = faces[0]
    more = [(0, 0, 5), (0, 0, 6), (0, 3, 0), (7, 7, 7)]
    fin = (first[0], first[1], len(vertices) + 2)
    double = tuple(reversed(first[1:] + first[:1]))
    flat = (first[0], first[1], len(vertices) + len(more))
    middle = (np.array(vertices[first[0]]) + vertices[first[1]]) / 2
    vertices += [*more, tuple(middle)]
    loose_edge = (len(box.vertices), len(box.vertices) + 1)
    mesh.from_pydata(vertices, [loose_edge], [*faces, fin, double, flat])
    mesh.shade_smooth()
    return mesh


def test_a_non_manifold_mesh(scene, record_property):
    """A smooth cube with a fin, a doubled and flipped face, a face without area, a loose edge and
    loose vertices: finite, between none and all of the sky; loose vertices show 0."""
    obj = place(non_manifold())
    baked(scene, obj)
    seen = held(obj)[:, 0] / FULL
    record_property("measured", max(0.0, -seen.min(), seen.max() - 1))
    assert np.isfinite(held(obj)).all()
    assert -1e-6 < seen.min() <= seen.max() < 1 + 1e-5
    loose = np.ones(len(obj.data.vertices), bool)
    loose[[v for p in obj.data.polygons for v in p.vertices]] = False
    assert loose.sum() == 3
    assert not seen[loose].any()


def test_a_world_with_every_fault(scene, tmp_path, record_property):
    """A half-float HDRI with NaN, infinite and negative texels and a sun of 65,504: baked, every
    value finite, every repair in the report."""
    pixels = np.full((16, 32, 3), 0.5, np.float16)
    pixels[2, 3], pixels[4, 5], pixels[6, 7], pixels[8, 9] = np.nan, np.inf, -1, 65504
    planes = {c: np.ascontiguousarray(pixels[..., i]) for i, c in enumerate("RGB")}
    path = str(tmp_path / "faults.exr")
    OpenEXR.File({"type": OpenEXR.scanlineimage}, planes).write(path)
    environment(scene, bpy.data.images.load(path))
    obj = place(ball())
    report = baked(scene, obj, world=False)
    error = open_error(obj)
    record_property("measured", error)
    assert error < 1e-5
    assert report["light"]["repaired"] == {"negative": 1, "nan": 1, "infinite": 1}
    light = json.loads(scene["prt_light"])
    assert np.isfinite(light["radiance_sh"]).all()
