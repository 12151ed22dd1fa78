"""What a bake leaves alone: Cycles' picture of any object, EEVEE's of unbaked ones, and both after
Remove Bake; with the real engine, through the operators.

Exactly.  Only where several objects in view no longer share one mesh does Cycles round otherwise.
"""

import bpy
import numpy as np
from bakes import add, link, output_of, principled
from meshes import ball, cube, place
from pictures import look_down, render
from prt_baker.addon import stamp
from worlds import environment, generated, picture

ROW = ("Plain", "Unbaked", "Subdivided", "Bevelled", "Shared", "Keyed", "Bare")


def material():
    """With displacement and texture coordinates that the mesh generates."""
    made = principled("Shared", Roughness=0.3, Base_Color=(0.8, 0.5, 0.2, 1))
    noise, bump = add(made, "TexNoise", Scale=7), add(made, "Displacement", Scale=0.1)
    bsdf = next(n for n in made.node_tree.nodes if n.type == "BSDF_PRINCIPLED")
    link(made, noise.outputs[0], bump.inputs["Height"])
    link(made, noise.outputs[0], bsdf.inputs["Metallic"])
    link(made, bump.outputs[0], output_of(made).inputs["Displacement"])
    return made


def row(scene):
    """One object a metre, of each kind that a bake writes in its own way."""
    environment(scene, generated(picture()), 0.3)
    shared = material()
    meshes = [ball(), ball(), cube(), cube(), cube(), ball(), ball(smooth=False)]
    for x, (name, mesh) in enumerate(zip(ROW, meshes, strict=True)):
        if name != "Bare":
            mesh.materials.append(shared)
        obj = place(mesh, name)
        obj.scale, obj.location = (0.4, 0.4, 0.4), (x + 0.5, 0.5, 0.4)
    bpy.data.objects["Subdivided"].modifiers.new("Subdivision", "SUBSURF")
    bpy.data.objects["Bevelled"].modifiers.new("Bevel", "BEVEL")
    place(bpy.data.objects["Shared"].data, "Hidden").hide_set(True)
    bpy.data.objects["Hidden"].hide_render = True
    keyed = bpy.data.objects["Keyed"]
    keyed.shape_key_add(name="Basis")
    keyed.shape_key_add(name="Wide").data[3].co.x += 0.5
    keyed.data.shape_keys.key_blocks["Wide"].value = 1
    look_down(scene, len(ROW), 1)
    bpy.context.view_layer.update()


def pictures(scene, folder):
    return render(scene, folder), render(scene, folder, "CYCLES", samples=4)


def same(one, other, part=np.s_[:, :]):
    assert one.keys() == other.keys()
    for name in one:
        np.testing.assert_array_equal(one[name][part], other[name][part], err_msg=name)


def test_cycles_and_unbaked_and_removed_look_as_before(scene, tmp_path):
    row(scene)
    scene.prt.rays = 16
    render(scene, tmp_path)  # EEVEE's first picture of a subdivided mesh differs from its second
    eevee, cycles = pictures(scene, tmp_path)
    for name in ROW:
        bpy.data.objects[name].select_set(name != "Unbaked")
    bpy.ops.prt.bake()
    assert [name for name in ROW if stamp.KEY not in bpy.data.objects[name]] == ["Unbaked"]
    assert stamp.read(bpy.data.objects["Shared"]).by_modifier
    baked, cycles_baked = pictures(scene, tmp_path)
    same(cycles_baked, cycles)
    same(baked, eevee, np.s_[:, 10:20])
    for x, name in enumerate(ROW):
        if name != "Unbaked":
            square = np.s_[3:7, 10 * x + 3 : 10 * x + 7]
            changed = np.abs(baked["Combined.R"][square] - eevee["Combined.R"][square])
            assert changed.max() > 0.01, name
    bpy.ops.prt.remove_bake()
    after, cycles_after = pictures(scene, tmp_path)
    same(cycles_after, cycles)
    same(after, eevee)
