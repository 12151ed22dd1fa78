"""What we write is valid glTF, and its extras are as docs/gltf.schema.json has them."""

import pytest
from glb_edit import of_mesh, of_scene, rewritten
from gltf_scenes import BAKED, export, monkey
from gltf_validator import assert_valid
from prt_baker.addon import gltf_export


@pytest.mark.parametrize("make", BAKED.values(), ids=BAKED)
def test_every_kind_of_file_is_valid(scene, bake, out, make):
    make(bake)
    glb = export(out)
    assert any("prt" in mesh.get("extras", {}) for mesh in glb.document["meshes"])
    assert any("prt_light" in found.get("extras", {}) for found in glb.document["scenes"])
    assert_valid(out)


T9 = [f"T{i}" for i in range(9)]
RESIDUAL = ["R0r", "R0g", "R0b"]


@pytest.mark.parametrize(
    "change",
    [
        of_mesh(version=2),
        of_mesh(order=2),
        of_mesh(order=6),
        of_mesh(channels=3),
        of_mesh(layout=[*T9[:8], "T9", *RESIDUAL]),
        of_mesh(layout=[*T9, "r0", "r1", "r2"]),
        of_mesh(layout=[*T9, "V0", "V1", "V2"]),
        of_mesh(layout=[*T9, *RESIDUAL, "R1r", "R1g", "R1b", ""]),
        of_mesh(turns=2),
        of_mesh(offset=[0] * 12),
        of_mesh(texture={"images": [0, 1, 2, 3], "texCoord": 0}),
        of_mesh(texture={"images": [0], "texCoord": -1}, offset=[0] * 12, scale=[1] * 12),
        of_mesh(clusters={"layout": ["W0", "W1", "W2", "W3"], "values": [0] * 48}),
        of_mesh(clusters={"layout": ["K", "W0", "W1", "W2"], "values": []}),
        of_mesh(clusters={"layout": ["K", "W0", "W1", "W2"], "values": [0] * 48}, scale=[1] * 12),
        of_mesh(frame="local"),
        of_mesh(matrix=[1] * 8),
        of_mesh(scale="1"),
        of_mesh(scale=0.5),
        of_mesh(basis="another"),
        of_mesh(more=1),
        of_scene(order=3),
        of_scene(radiance_sh=[[0, 0, 0]] * 24),
        of_scene(baked_radiance_sh=[[0, 0]] * 25),
        of_scene(lights=[{"direction": [0, 0, 1], "irradiance": [1, 1, 1]}]),
        of_scene(lights=[{"direction": [0, 0, 2], "irradiance": [1, 1, 1], "angular_radius": 0}]),
    ],
)
def test_the_schema_can_fail(scene, bake, out, change):
    bake(monkey(), turns=1)
    gltf_export.write(str(out))
    rewritten(out, change)
    with pytest.raises(AssertionError, match="/extras/prt"):
        assert_valid(out)


def test_extras_of_a_valid_file_may_be_rewritten(scene, bake, out):
    """``rewritten`` breaks nothing by itself."""
    bake(monkey(), turns=1)
    gltf_export.write(str(out))
    rewritten(out, of_mesh(layout=[*T9, *RESIDUAL]))
    assert_valid(out)
