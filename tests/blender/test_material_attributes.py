"""EEVEE reads 14 attributes in a material, the artist's included: more is refused beforehand."""

import bpy
import pytest
from bakes import add, full, link, output_of, principled, quad, shader, write
from prt_baker.addon import material_attributes, writeback
from prt_baker.addon.prt.errors import BakeError
from prt_baker.addon.prt.layout import Layout

LAYOUT = Layout(3)


def test_as_many_as_fit_are_let_through(scene):
    writeback.check(scene, [quad(scene, material=full(11))], LAYOUT)


def test_one_more_is_refused_by_name(scene):
    with pytest.raises(BakeError, match="beside the 12 that material 'Full' reads"):
        writeback.check(scene, [quad(scene, material=full(12))], LAYOUT)


def test_order_5_with_three_channels_never_fits(scene):
    with pytest.raises(BakeError, match="order 5 with 3 channels"):
        writeback.check(scene, [quad(scene)], Layout(5, 3))


def test_nodes_that_lead_nowhere_do_not_count(scene):
    material = full(12)
    link(material, add(material, "Emission").outputs[0], output_of(material).inputs[0])
    assert not material_attributes.of(material)


@pytest.mark.parametrize(
    ("kinds", "count"),
    [
        (["TexImage"], 1),
        (["TexImage", "TexImage"], 1),
        (["TexNoise", "TexVoronoi", "TexSky"], 1),
        (["TexCoord"], 1),
        (["TexImage", "TexCoord"], 1),
        (["TexImage", "UVMap:uv_map=UVMap"], 2),
        (["UVMap:uv_map=Name", "Attribute:attribute_name=Name"], 1),
        (["VertexColor:layer_name=Name", "Attribute:attribute_name=Name"], 1),
        (["NormalMap", "NormalMap:uv_map=UVMap"], 2),
        (["NormalMap:space=OBJECT"], 0),
        (["Tangent", "TexNoise"], 1),
        (["Attribute:attribute_type=OBJECT"], 0),
        (["TexEnvironment", "ObjectInfo", "Wireframe", "TexWhiteNoise"], 0),
    ],
)
def test_what_counts(scene, kinds, count):
    material = principled()
    total = None
    for kind in kinds:
        name, _, setting = kind.partition(":")
        node, term = add(material, name), add(material, "VectorMath")
        if setting:
            setattr(node, *setting.split("="))
        source = node.outputs["Object" if name == "TexCoord" else 0]
        link(material, source, term.inputs[0])
        if total is not None:
            link(material, total, term.inputs[1])
        total = term.outputs[0]
    link(material, total, shader(material).inputs["Base Color"])
    assert len(material_attributes.of(material)) == count


def test_groups_are_looked_into(scene):
    material, inside = principled(), bpy.data.node_groups.new("Inside", "ShaderNodeTree")
    inside.interface.new_socket("Color", in_out="OUTPUT", socket_type="NodeSocketColor")
    attribute = inside.nodes.new("ShaderNodeAttribute")
    attribute.attribute_name = "Own"
    end = inside.nodes.new("NodeGroupOutput")
    inside.links.new(attribute.outputs[0], end.inputs[0])
    node = add(material, "Group")
    node.node_tree = inside
    link(material, node.outputs[0], shader(material).inputs["Base Color"])
    assert len(material_attributes.of(material)) == 1


def test_a_bake_does_not_count_itself(scene):
    obj = quad(scene, material=full(11))
    write(scene, LAYOUT, obj)
    writeback.check(scene, [obj], LAYOUT)
