"""Bakes in clusters of principal components: within the error asked for, in fewer bytes."""

import bpy
import numpy as np
import pytest
from glb import Glb
from glb_edit import of_mesh, rewritten
from gltf_scenes import COLORS, colored, mirrored, monkey
from gltf_validator import assert_valid
from prt_baker.addon import (
    attributes,
    carrier,
    gltf,
    gltf_export,
    gltf_panel,
    light_state,
    stamp,
)
from prt_baker.addon.prt import sh
from prt_baker.addon.prt.job import Peak
from prt_baker.addon.prt.layout import Values
from prt_baker.addon.prt.light import residual
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation
from test_gltf_import import imported
from test_viewer import LOOK
from test_viewer_pixels import OPEN, nearly_baked_light, see
from viewer_laws import expected


@pytest.fixture
def both(registered, scene, out):
    """Write the file with floats and compressed; both, read."""

    def write(error=0.01):
        files = []
        for its_error in (None, error):
            with gltf_panel.chosen(scene, None, its_error):
                gltf_export.write(str(out))
            files.append(Glb(out))
        assert not scene.prt.gltf_compress
        assert_valid(out)
        return files

    return write


def subdivided():
    """About 8,000 vertices, four times as many in the file."""
    obj = mirrored()
    modifier = obj.modifiers.new("Subdivision", "SUBSURF")
    modifier.levels = 2
    return obj


def smoothly(bake, obj, **stored):
    bake(obj, by_modifier=bool(obj.modifiers), smooth=True, bent=True, **stored)
    return obj


KINDS = {
    "order 3, residual": {"turns": 1},
    "order 5, peaks": {"order": 5, "turns": 1, "lights": 2},
    "order 3, three channels": {"channels": 3, "turns": 1},
    "twelve turns": {"turns": 12},
    "what is seen": {"turns": 1, "seen": 3},
}


@pytest.mark.parametrize("stored", KINDS.values(), ids=KINDS)
def test_the_light_is_within_the_error_asked_for(scene, bake, both, stored):
    obj = smoothly(bake, subdivided(), **stored)
    exact, coded = both(0.01)
    prt = coded.prt(obj.name)
    assert prt["clusters"]["error"] <= 0.01
    off, truth = (seen(glb, obj.name) for glb in (coded, exact))
    assert rms(off - truth) <= 0.0101 * rms(truth)
    assert rms(off - truth) > 0
    assert weight(coded, obj.name) < 0.4 * weight(exact, obj.name)


def seen(glb, name):
    """Exit radiance (E, 3) of a white surface under the baked light, not clamped."""
    light = glb.document["scenes"][0]["extras"]["prt_light"]
    baked, prt = np.array(light["baked_radiance_sh"]), glb.prt(name)
    peaks = [
        Peak(tuple(one["direction"]), tuple(one["irradiance"]), one["angular_radius"])
        for one in light["lights"]
    ]
    lights = sum(slot[:1] == "S" for slot in prt["layout"])
    coefficients = baked - residual.peaks_sh(tuple(peaks[:lights]))
    total = np.einsum(
        "eci,ic->ec",
        np.broadcast_to(glb.transfer(name), (len(glb.transfer(name)), 3, prt["order"] ** 2)),
        coefficients[: prt["order"] ** 2],
    )
    if "R0r" in prt["layout"]:
        total += glb.slots(name, ["R0r", "R0g", "R0b"])
    for j in range(lights):
        total += glb.slots(name, [f"S{j}"]) * np.array(peaks[j].irradiance) / np.pi
    return total


def rms(values):
    return np.sqrt(np.square(values).mean())


def weight(glb, name):
    """Bytes of the attributes, and of the clusters as JSON."""
    attributes_of = glb.mesh(name)["primitives"][0]["attributes"]
    accessors = [glb.document["accessors"][a] for n, a in attributes_of.items() if "_PRT_" in n]
    views = [glb.document["bufferViews"][a["bufferView"]] for a in accessors]
    values = glb.prt(name).get("clusters", {}).get("values", [])
    return sum(view["byteLength"] for view in views) + len(str(values))


def test_the_report_tells_bytes_and_errors(scene, bake, both):
    obj = smoothly(bake, subdivided(), turns=1)
    _, coded = both(0.01)
    (entry,) = gltf.REPORT
    assert entry["name"] == obj.name
    assert entry["chosen"]["error"] == coded.prt(obj.name)["clusters"]["error"]
    assert entry["chosen"]["bytes"] == pytest.approx(weight(coded, obj.name), rel=0.1)
    assert entry["tried"][-1] == entry["chosen"]


def test_a_smaller_error_takes_more_bytes(scene, bake, both):
    obj = smoothly(bake, subdivided(), turns=1)
    weights = [weight(both(error)[1], obj.name) for error in (0.1, 0.003)]
    assert weights[0] < 0.8 * weights[1]


def test_what_gains_nothing_has_16_bits(scene, bake, both):
    bake(monkey(), turns=1)
    _, coded = both(0.001)
    prt = coded.prt("Monkey")
    assert "clusters" not in prt
    assert len(prt["scale"]) == 12
    assert gltf.REPORT[0]["chosen"] is None


def test_several_primitives_share_their_clusters(scene, bake, both):
    obj = colored(COLORS, "Dirt")
    modifier = obj.modifiers.new("Subdivision", "SUBSURF")
    modifier.levels = 2
    smoothly(bake, obj, turns=1)
    exact, coded = both(0.02)
    assert len(coded.mesh(obj.name)["primitives"]) == 2
    assert "clusters" in coded.prt(obj.name)
    off = seen(coded, obj.name) - seen(exact, obj.name)
    assert rms(off) <= 0.0201 * rms(seen(exact, obj.name))


@pytest.mark.parametrize("stored", KINDS.values(), ids=KINDS)
def test_what_comes_back_is_within_the_error_that_the_file_states(scene, bake, both, stored):
    """The light that leaves it, which no turn of the axes changes: under the baked light, and, of
    the transfer, under that light turned."""
    obj = smoothly(bake, subdivided(), **stored)
    name, layout, before = obj.name, stamp.read(obj).packing, held(obj)
    _, coded = both(0.01)
    stated = coded.prt(name)["clusters"]["error"]
    scene = imported(coded.path)
    obj = bpy.data.objects[name]
    assert stamp.read(obj).packing == layout
    places, found = held(obj)
    assert len(places) == len(seen(coded, name))
    nearest = cKDTree(before[0]).query(places)[1]
    truth = Values(*(part[nearest] for part in vars(before[1]).values()))
    state = light_state.read(scene)
    light = [under_baked_light(values, state) for values in (truth, found)]
    assert 0 < rms(light[1] - light[0]) <= (stated + 1e-5) * rms(light[0])
    turns = Rotation.random(100, random_state=3).as_matrix()
    turned = [sh.rotate(state.baked_radiance_sh, turn) for turn in turns]
    error = found.transfer.astype(float) - truth.transfer
    errors = [rms(residual.shaded(error, one)) for one in turned]
    assert 0 < rms(errors) <= (stated + 1e-5) * rms(light[0])


def held(obj):
    """Where the vertices of ``obj`` are, (E, 3), and what they hold."""
    with carrier.evaluated_mesh(obj, bpy.context.evaluated_depsgraph_get()) as mesh:
        places = np.array([vertex.co[:] for vertex in mesh.vertices])
    return places, attributes.read(obj, stamp.read(obj))


def under_baked_light(values, state):
    """What leaves a white surface that holds ``values``, not clamped."""
    light = state.baked_radiance_sh
    turns = values.residual.shape[1]
    terms = residual.terms(light, light, turns, state.peaks[: values.visibility.shape[1]])
    return residual.shaded(values.transfer, light) + residual.beyond(values, terms)


@pytest.mark.parametrize("stored", [KINDS["order 5, peaks"], KINDS["twelve turns"]], ids=str)
def test_pixels_are_those_of_the_bake_that_comes_back(scene, bake, both, page, stored):
    """The viewer never decodes it, and Blender does, so both have to mean the same."""
    nearly_baked_light(scene)
    name = smoothly(bake, subdivided(), **stored).name
    _, coded = both(0.05)
    camera = page.run(OPEN, glb=coded.path)
    assert camera["problems"] == []
    imported(coded.path)
    obj = bpy.data.objects[name]
    for environment, model in ((0, 0), (77, 40)):
        pixels, truth = expected([obj], camera, environment, model)
        floats, _ = see(page, pixels, environment, model)
        assert len(pixels) > 40
        np.testing.assert_allclose(floats, truth, rtol=1e-3, atol=1e-3)


def layout_of(document, **values):
    document["meshes"][0]["extras"]["prt"]["clusters"].update(values)


def first_values(document):
    return document["meshes"][0]["extras"]["prt"]["clusters"]["values"]


MALFORMED = {
    "clusters' layout is not K, W0": lambda d: layout_of(d, layout=["K", "W1", "W2", "W3"]),
    "clusters' layout is not K": lambda d: layout_of(d, layout=["W0", "W1", "W2", "W3"]),
    "clusters' layout is": lambda d: layout_of(d, layout=7),
    "clusters' values are not": lambda d: layout_of(d, values=first_values(d)[:-1]),
    "clusters' values are": lambda d: layout_of(d, values=["x"] * len(first_values(d))),
    "and there are 1": lambda d: layout_of(d, values=first_values(d)[: 12 * 4]),
    "layout has no T8": of_mesh(layout=[*(f"T{i}" for i in range(8)), "R0r", "R0g", "R0b"]),
    "attribute _PRT_0 is missing": lambda d: d["meshes"][0]["primitives"][0]["attributes"].pop(
        "_PRT_0"
    ),
}


@pytest.mark.parametrize("sentence", MALFORMED)
def test_what_is_malformed_is_named(registered, scene, bake, out, page, capfd, sentence):  # noqa: PLR0917
    obj = monkey()
    obj.modifiers.new("Subdivision", "SUBSURF").levels = 2
    smoothly(bake, obj, turns=1)
    with gltf_panel.chosen(scene, None, 0.06):
        gltf_export.write(str(out))
    assert page.run(LOOK, glb=out)["problems"] == []
    rewritten(out, MALFORMED[sentence])
    said = page.run(LOOK, glb=out)
    assert said["plain"]
    assert sentence in said["problems"][0]
    scene = imported(out)
    assert sentence in capfd.readouterr().out
    assert not stamp.baked_objects(scene)


def test_without_a_light_they_are_chosen_by_a_white_one(registered, scene, bake, out):
    obj = smoothly(bake, subdivided(), turns=1)
    del scene[light_state.KEY]
    with gltf_panel.chosen(scene, None, 0.01):
        gltf_export.write(str(out))
    assert Glb(out).prt(obj.name)["clusters"]["error"] <= 0.01
