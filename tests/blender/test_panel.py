"""What the panels show, on a layout that only notes it."""

from dataclasses import replace
from types import SimpleNamespace

import bpy
import pytest
from prt_baker.addon import figures, light_state, live_light, run_state, stamp
from prt_baker.addon.prt.job import Progress
from prt_baker.addon.prt.layout import Layout
from prt_baker.ui import panel, result_panel, settings_panel
from stamped import MARK, put_bake


class Noting:
    """A layout: what is drawn in it or in a part of it lands in ``notes``."""

    def __init__(self, notes):
        self.notes = notes

    def row(self, **_keywords):
        return Noting(self.notes)

    column = box = row

    def label(self, text, **_keywords):
        self.notes.append(text)

    def operator(self, idname, text="", **_keywords):
        self.notes.append(f"[{idname} {text}]")

    def prop(self, _owner, name):
        self.notes.append(f"<{name}>")

    def progress(self, factor, text):
        self.notes.append(f"{factor:.2f} {text}")

    def template_ID(self, _owner, name, new):  # noqa: N802 - Blender's name
        self.notes.append(f"<{name} {new}>")


@pytest.fixture
def context(scene):
    """Blender's context with a sidebar, a world and a cube."""
    scene.world = bpy.data.worlds.new("World")
    bpy.ops.mesh.primitive_cube_add()
    return SimpleNamespace(
        scene=scene,
        view_layer=bpy.context.view_layer,
        visible_objects=bpy.context.visible_objects,
        selected_objects=[bpy.context.object],
        region=SimpleNamespace(width=2000),
        preferences=SimpleNamespace(system=SimpleNamespace(ui_scale=1.0)),
    )


def drawn(cls, context):
    """The notes of a panel."""
    notes = []
    cls.draw(SimpleNamespace(layout=Noting(notes)), context)
    return notes


def test_bake_says_how_many_objects_it_is_about(context):
    assert drawn(panel.PRT_PT_bake, context) == ["[prt.bake Bake 1 Selected Object]"]
    context.selected_objects = []
    assert drawn(panel.PRT_PT_bake, context) == ["[prt.bake Bake 1 Visible Object]"]


def test_a_missing_world_is_told_and_can_be_made(context):
    context.scene.world = None
    notes = drawn(panel.PRT_PT_bake, context)
    assert notes[0] == panel.NO_WORLD
    assert notes[1] == "<world world.new>"


def test_a_job_shows_its_bar_and_a_way_out(context):
    run = run_state.begin("Bake PRT")
    run.progress = Progress("transfer", 0.25, 100, 10.0)
    try:
        assert drawn(panel.PRT_PT_bake, context) == [
            "0.25 Bake PRT: 25 %",
            "[prt.cancel ]",
            "Tracing, 30 s left",
        ]
    finally:
        run_state.end(run)


def test_the_result_of_one_bake_is_its_stamp(context):
    put_bake(context.scene, *context.selected_objects)
    assert drawn(result_panel.PRT_PT_result, context) == [
        "Cube",
        "Order 3, 8 points",
        "256 rays a point, 1.0 Mrays/s",
        "1.2 % noise, estimated",
        "[prt.verify ]",
        "[prt.remove_bake ]",
    ]


def test_bakes_are_summed_up_and_stale_ones_counted(context):
    bpy.ops.mesh.primitive_cube_add()
    both = [*context.selected_objects, bpy.context.object]
    put_bake(context.scene, *both)
    for obj in both:
        obj["prt_baked"] = 0.0
    context.selected_objects = []
    notes = drawn(result_panel.PRT_PT_result, context)
    assert notes[:2] == ["Together", "2 objects, 16 points"]
    assert notes[3] == "1.2 % noise, estimated"
    assert notes[4].startswith("2 objects changed since the bake")


def test_a_stale_bake_says_why(context):
    cube = context.selected_objects[0]
    put_bake(context.scene, cube)
    cube["prt_baked"] = 0.0
    cube.location.x = 3
    bpy.context.view_layer.update()
    assert any("moved" in note for note in drawn(result_panel.PRT_PT_result, context))


def test_panels_of_results_hide_until_there_are_some(context):
    assert not result_panel.PRT_PT_light.poll(context)
    put_bake(context.scene, *context.selected_objects)
    assert result_panel.PRT_PT_light.poll(context)


def test_the_light_says_whether_it_follows(context, monkeypatch):
    put_bake(context.scene, *context.selected_objects)
    monkeypatch.setattr(live_light, "problem", "")
    assert drawn(result_panel.PRT_PT_light, context)[0] == "Follows the world"
    state = light_state.read(context.scene)
    light_state.write(context.scene, light_state.LightState(**{**vars(state), "follows": False}))
    assert drawn(result_panel.PRT_PT_light, context)[0] == result_panel.MUST_UPDATE
    monkeypatch.setattr(live_light, "problem", "The image is gone")
    assert drawn(result_panel.PRT_PT_light, context)[0] == "The image is gone"


def test_lamps_are_said_to_be_left_out(context):
    put_bake(context.scene, *context.selected_objects)
    assert result_panel.NO_LAMPS not in drawn(result_panel.PRT_PT_light, context)
    bpy.ops.object.light_add(type="SUN")
    assert result_panel.NO_LAMPS in drawn(result_panel.PRT_PT_light, context)


def test_the_settings_tell_what_an_order_costs(context):
    context.scene.prt.order = 5
    notes = drawn(settings_panel.PRT_PT_settings, context)
    assert notes[:3] == ["<carrier>", "<order>", "7 of EEVEE's 14 attributes"]
    assert notes[3:5] == ["<bounces>", "<all_bounces>"]
    assert notes[5:] == ["<reflections>", "<quality>", "<rays>", "<seed>", "<threads>"]
    context.scene.prt.quality = "TOLERANCE"
    assert drawn(settings_panel.PRT_PT_settings, context)[7] == "<tolerance>"


@pytest.mark.parametrize(("order", "whole", "more"), [("3", 6, "3 attributes"), ("2", 4, "1 attr")])
def test_the_settings_tell_what_occlusion_of_reflections_costs(context, order, whole, more):
    chosen = context.scene.prt
    chosen.visibility_order, chosen.reflections = order, False
    assert "<visibility_order>" not in drawn(settings_panel.PRT_PT_settings, context)
    chosen.reflections = True
    notes = drawn(settings_panel.PRT_PT_settings, context)
    assert f"{whole} of EEVEE's 14 attributes" in notes
    hint = notes[notes.index("<visibility_order>") + 1]
    assert hint.startswith(f"{more}")
    assert hint.endswith("of them, and no more rays")
    chosen.carrier = "TEXTURE"
    assert not any("of them" in note for note in drawn(settings_panel.PRT_PT_settings, context))


def test_the_settings_tell_what_colours_that_bounce_cost(context):
    context.scene.prt.bounces = 3
    whole = "3 of EEVEE's 14 attributes, 8 where colours bounce"
    assert whole in drawn(settings_panel.PRT_PT_settings, context)


def test_the_settings_tell_what_direct_light_costs_where_light_bounces(context):
    chosen = context.scene.prt
    chosen.keep_direct = True
    assert "<keep_direct>" not in drawn(settings_panel.PRT_PT_settings, context)
    chosen.bounces = 3
    for carrier, words in (
        ("VERTEX", "3 attributes that EEVEE does not read, no more rays"),
        ("TEXTURE", "a second image, which EEVEE does not read, no more rays"),
        ("AUTO", "3 attributes that EEVEE does not read, or a second image, no more rays"),
    ):
        chosen.carrier = carrier
        notes = drawn(settings_panel.PRT_PT_settings, context)
        assert notes[notes.index("<keep_direct>") + 1] == words
    chosen.keep_direct = False
    assert words not in drawn(settings_panel.PRT_PT_settings, context)


def test_the_settings_tell_what_a_texture_costs(context):
    chosen = context.scene.prt
    assert not settings_panel.PRT_PT_texture.poll(context)
    chosen.carrier = "TEXTURE"
    assert settings_panel.PRT_PT_texture.poll(context)
    assert not any("attributes" in note for note in drawn(settings_panel.PRT_PT_settings, context))
    notes = drawn(settings_panel.PRT_PT_texture, context)
    assert notes[:3] == ["<size_by>", "<resolution>", "89 MB on the graphics card"]
    assert notes[-2:] == ["<image_folder>", "<engine_images>"]
    chosen.size_by = "DENSITY"
    assert drawn(settings_panel.PRT_PT_texture, context)[1] == "<texel_density>"


def test_the_settings_tell_what_turns_and_peaks_cost(context):
    chosen = context.scene.prt
    chosen.turns, chosen.peaks = 12, 4
    assert "13 of EEVEE's 14 attributes" in drawn(settings_panel.PRT_PT_settings, context)
    chosen.residual = False
    assert "4 of EEVEE's 14 attributes" in drawn(settings_panel.PRT_PT_settings, context)
    notes = drawn(settings_panel.PRT_PT_exact, context)
    assert notes == ["<residual>", "<turns>", "<peaks>", "<final_light>"]


def test_what_belongs_to_another_light_is_told(context):
    cube = context.selected_objects[0]
    put_bake(context.scene, cube)
    stamp.write(cube, replace(MARK, layout=Layout(3, turns=1).slots))
    stamp.set_share(cube, 0.0)
    told = figures.another_light(cube.name)
    assert told in drawn(result_panel.PRT_PT_result, context)
    stamp.set_share(cube, 1.0)
    assert told not in drawn(result_panel.PRT_PT_result, context)


def test_sentences_wrap_at_the_sidebars_width(context):
    context.region.width = 240
    context.scene.world = None
    assert len(drawn(panel.PRT_PT_bake, context)) > 3
