"""What the viewer computes for a light, and what it says of files that it cannot show."""

import json

import bpy
import numpy as np
import pytest
from glb import Glb
from glb_edit import of_mesh, of_scene, of_texture, rewritten
from gltf_scenes import COLORS, colored, monkey, rotated
from gltf_textured import bake_in_texture
from gltf_worlds import bundled, hdri
from prt_baker.addon import gltf_export
from prt_baker.addon.prt import sh
from prt_baker.addon.prt.files import images
from prt_baker.addon.prt.job import Peak
from prt_baker.addon.prt.layout import Layout
from prt_baker.addon.prt.light import lat_long, residual

FRAME = np.array([[1.0, 0, 0], [0, 0, 1], [0, -1, 0]])  # from Z up to Y up
MODULES = "const sh = await import('./sh.js'), light = await import('./prt_light.js');"


def module(page, body, **values):
    """What ``body`` returns in the page, with ``values`` and the viewer's modules at hand."""
    return page.run(f"{MODULES} const {{ {', '.join(values)} }} = {json.dumps(values)}; {body}")


def random_rotation(rng):
    q, r = np.linalg.qr(rng.normal(size=(3, 3)))
    q *= np.sign(np.diag(r))
    return q * np.linalg.det(q)


def test_its_basis_and_rotations_are_those_of_the_engine(page):
    rng = np.random.default_rng(0)
    directions = rng.normal(size=(20, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    found = module(page, "return places.map((d) => sh.basis(...d));", places=directions.tolist())
    np.testing.assert_allclose(found, sh.basis(directions, 5), atol=1e-13)
    light, rotation = rng.normal(size=(25, 3)), random_rotation(rng)
    columns = rotation.ravel(order="F").tolist()
    found = module(page, "return sh.rotate(given, r);", given=light.tolist(), r=columns)
    np.testing.assert_allclose(found, sh.rotate(light, rotation), atol=1e-12)


PEAKS = (Peak((0.6, 0.0, 0.8), (3.0, 2.0, 1.0), 0.1), Peak((0.0, -1.0, 0.0), (1, 2, 3), 0.0))
LIGHTS = {
    "itself": lambda baked, rng: baked,
    "turned by 5°": lambda baked, rng: residual.turned(baked, 0.09),
    "turned by 200°": lambda baked, rng: residual.turned(baked, 3.5),
    "weaker and redder": lambda baked, rng: baked * (0.5, 0.3, 0.2),
    "another": lambda baked, rng: rng.normal(size=(25, 3)),
    "white": lambda baked, rng: np.eye(25)[:, :1] * np.ones(3),
    "dark": lambda baked, rng: 0 * baked,
}


@pytest.mark.parametrize("other", LIGHTS.values(), ids=LIGHTS)
@pytest.mark.parametrize("turns", [0, 1, 2, 12])
def test_its_weights_are_those_of_the_engine(page, turns, other):
    rng = np.random.default_rng(1)
    baked = rng.normal(size=(25, 3))
    now = other(baked, rng)
    lights = [
        {
            "direction": (FRAME @ np.array(peak.direction)).tolist(),
            "irradiance": list(peak.irradiance),
            "angular_radius": peak.angular_radius,
        }
        for peak in PEAKS
    ]
    found = module(
        page,
        "return light.terms(now, baked, turns, lights);",
        now=sh.rotate(now, FRAME).tolist(),
        baked=sh.rotate(baked, FRAME).tolist(),
        turns=turns,
        lights=lights,
    )
    truth = residual.terms(now, baked, turns, PEAKS)
    np.testing.assert_allclose(np.reshape(found["residual"], (-1, 3)), truth.residual, atol=1e-6)
    np.testing.assert_allclose(found["lights"], truth.lights, atol=1e-6)
    transfer = sh.rotate(now - truth.cut_out, FRAME)
    np.testing.assert_allclose(found["transfer"], transfer, atol=1e-5)


def rgbe(path, pixels):
    """A .hdr file of ``pixels``, top row first, uncompressed; what it holds."""
    mantissa, exponent = np.frexp(pixels.max(axis=2))
    scale = 256 * mantissa / np.maximum(pixels.max(axis=2), 1e-30)
    stored = np.dstack([pixels * scale[..., None], exponent + 128]).astype(np.uint8)
    head = f"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y {len(pixels)} +X {len(pixels[0])}\n"
    path.write_bytes(head.encode() + stored.tobytes())
    return stored[..., :3] * np.exp2(stored[..., 3:].astype(float) - 136)


@pytest.mark.parametrize("kind", ["exr", "hdr"])
def test_an_environment_is_projected_as_the_engine_does(page, tmp_path, kind):
    picture = np.maximum(images.read(str(bundled("night")))[::4, ::4, :3], 0)
    path = tmp_path / f"picture.{kind}"
    if kind == "exr":
        images.write_exr(str(path), picture)
    else:
        picture = rgbe(path, picture)
    body = f"return (await import('./environment.js')).read('a.{kind}', files.picture).light;"
    truth = sh.rotate(lat_long.project(picture.astype(np.float32), 5), FRAME)
    np.testing.assert_allclose(page.run(body, picture=path), truth, atol=1e-5 * truth[0, 0])


def test_a_dropped_environment_turns_as_the_world_of_the_blend(registered, scene, bake, out, page):
    """A Mapping turns what is looked up, so the picture the other way."""
    hdri(scene, "city", np.radians(-77))
    baked_by_engine(monkey())
    gltf_export.write(str(out))
    body = """
        await viewer.stage.loadModel(files.glb);
        viewer.stage.loadEnvironment('city.exr', files.city);
        viewer.stage.turn({ environment: 77 });
        const found = viewer.stage.shownLight;
        viewer.stage.resetEnvironment();
        return [found, viewer.stage.shownLight];
    """
    dropped, own = page.run(body, glb=out, city=bundled("city"))
    np.testing.assert_allclose(dropped, own, atol=1e-5 * np.max(own))


def test_the_background_stands_where_its_light_comes_from(scene, bake, out, page, tmp_path):
    """A lamp towards +x, turned by 77° about the vertical."""
    bake(monkey())
    gltf_export.write(str(out))
    body = """
        const { stage, THREE } = viewer;
        await stage.loadModel(files.glb);
        stage.resize(64, 64);
        stage.set({ background: true });
        stage.loadEnvironment('lamp.exr', files.lamp);
        stage.turn({ environment: 77, model: 0 });
        const brightness = (angle) => {
          const [x, z] = [Math.cos(angle), -Math.sin(angle)];
          stage.camera.position.set(100 * x, 0, 100 * z);
          stage.controls.target.set(200 * x, 0, 200 * z);
          const pixels = stage.readFloat(64, 64);
          return pixels[4 * (32 * 64 + 32)];
        };
        return [...Array(180).keys()].map((k) => brightness(k * Math.PI / 90));
    """
    picture = np.zeros((32, 64, 3), np.float32)
    picture[16, 31:33] = 1
    images.write_exr(str(tmp_path / "lamp.exr"), picture)
    found = np.array(page.run(body, glb=out, lamp=tmp_path / "lamp.exr"))
    angles = np.radians(2 * np.arange(180))
    brightest = np.angle((found * np.exp(1j * angles)).sum(), deg=True)
    assert abs(brightest - 77) < 2


MALFORMED = {
    "version 3": of_mesh(version=3),
    "order 7": of_mesh(order=7),
    "layout has no T8": of_mesh(layout=[*(f"T{i}" for i in range(8)), "", "R0r", "R0g", "R0b"]),
    "2 channels": of_mesh(channels=2),
    'frame "local"': of_mesh(frame="local"),
    "matrix is not nine numbers": of_mesh(matrix=[1, 2]),
    "matrix is all zeros": of_mesh(matrix=[0] * 9),
    "scale is neither 1 nor 12 numbers": of_mesh(scale=[1, 2]),
    "layout is not four names": of_mesh(layout=["T0"]),
    "layout has T9": of_mesh(layout=[*(f"T{i}" for i in range(10)), "R0r", "R0g"], turns=0),
    "the light's radiance_sh is not 25 triples": of_scene(radiance_sh=[[1, 2, 3]]),
    "A cut-out light".lower(): of_scene(lights=[{"direction": [0, 0, 0]}]),
    "no prt_light": lambda document: document["scenes"][0].pop("extras"),
    "attribute _PRT_1 is missing": lambda document: drop(document, "_PRT_1"),
    "attribute _PRT_1 is no VEC4": lambda document: swap(document, "_PRT_1", "NORMAL"),
}


IN_TEXTURE = {
    "layout is not three names a picture": of_mesh(layout=["T0", "T1", "T2", "T3"]),
    "offset is not 12 numbers": of_mesh(offset=[0]),
    "scale is neither 1 nor 12 numbers": of_mesh(scale=[None] * 12),
    "texture has not 4 images": of_texture(images=[0, 1]),
    "image 99 is not in the file": of_texture(images=[0, 1, 2, 99]),
    "attribute TEXCOORD_7 is missing": of_texture(texCoord=7),
    "a picture of the bake is 8 by 8, and not 8 by 16": lambda document: pictures_of(
        document
    ).insert(0, artists_image(document)),
    "cannot be decoded": lambda document: document["images"][pictures_of(document)[1]].update(
        bufferView=document["accessors"][attributes_of(document)["POSITION"]]["bufferView"]
    ),
}


def pictures_of(document):
    return document["meshes"][0]["extras"]["prt"]["texture"]["images"]


def artists_image(document):
    """Its index; the bake's last one makes room."""
    pictures_of(document).pop()
    return next(i for i, image in enumerate(document["images"]) if image["name"] == "Artist's")


def attributes_of(document):
    return document["meshes"][0]["primitives"][0]["attributes"]


def drop(document, name):
    del attributes_of(document)[name]


def swap(document, name, other):
    attributes_of(document)[name] = attributes_of(document)[other]


LOOK = """
    const said = await viewer.stage.loadModel(files.glb);
    const plain = viewer.stage.primitives.every((one) => one.mesh.material === one.plain);
    return { ...said, plain };
"""


@pytest.mark.parametrize("sentence", MALFORMED)
def test_what_is_malformed_is_named_and_shown_plain(scene, bake, out, page, sentence):
    bake(monkey(), turns=1)
    gltf_export.write(str(out))
    rewritten(out, MALFORMED[sentence])
    said = page.run(LOOK, glb=out)
    assert said["baked"] == 0
    assert said["plain"]
    assert len(said["problems"]) == 1
    assert sentence in said["problems"][0]
    assert "plain material" in said["problems"][0]


@pytest.mark.parametrize("sentence", IN_TEXTURE)
def test_what_is_malformed_in_a_texture_is_named_and_shown_plain(
    scene, out, page, tmp_path, sentence
):
    bake_in_texture(tmp_path, [pictured(monkey())])
    gltf_export.write(str(out))
    assert page.run(LOOK, glb=out)["problems"] == []
    rewritten(out, IN_TEXTURE[sentence])
    said = page.run(LOOK, glb=out)
    assert said["baked"] == 0
    assert said["plain"]
    assert len(said["problems"]) == 1
    assert sentence in said["problems"][0]
    assert "plain material" in said["problems"][0]


def pictured(obj):
    """``obj`` with a material that shows an image of 8 x 8."""
    material = bpy.data.materials.new("Pictured")
    if bpy.app.version < (5, 0):
        material.use_nodes = True
    node = material.node_tree.nodes.new("ShaderNodeTexImage")
    node.image = bpy.data.images.new("Artist's", 8, 8)
    shader = next(n for n in material.node_tree.nodes if n.type == "BSDF_PRINCIPLED")
    material.node_tree.links.new(node.outputs["Color"], shader.inputs["Base Color"])
    obj.data.materials.append(material)
    return obj


@pytest.mark.parametrize("floats", [True, False])
def test_pictures_are_decoded_to_the_number(scene, out, page, tmp_path, floats):
    """Half floats, where floats cannot be filtered, lose 1/1024 at most."""
    obj = monkey()
    bake_in_texture(tmp_path, [obj], Layout(5, turns=1), size=32)
    gltf_export.write(str(out))
    body = f"""
        const {{ stage, THREE }} = viewer, {{ extensions }} = stage.renderer;
        const {{ has }} = extensions;
        extensions.has = (name) => name !== 'OES_texture_float_linear' || {str(floats).lower()};
        try {{ await stage.loadModel(files.glb); }} finally {{ extensions.has = has; }}
        const {{ atlas, layout }} = stage.primitives[0].bake, {{ width }} = atlas.image;
        const target = atlas.renderTarget, Numbers = {"Float32Array" if floats else "Uint16Array"};
        return Array.from({{ length: layout.length / 4 | 0 }}, (_, k) => {{
          const values = new Numbers(4 * width * width);
          stage.renderer.setRenderTarget(target, k);
          const gl = stage.renderer.getContext();
          const kind = {"gl.FLOAT" if floats else "gl.HALF_FLOAT"};
          gl.readPixels(0, 0, width, width, gl.RGBA, kind, values);
          stage.renderer.setRenderTarget(null);
          return Array.from(values, {"(v) => v" if floats else "THREE.DataUtils.fromHalfFloat"});
        }});
    """
    glb = Glb(out)
    truth = glb.atlas(obj.name)
    found = np.reshape(page.run(body, glb=out), (-1, 32, 32, 4))
    found = found.transpose(1, 2, 0, 3).reshape(32, 32, -1)
    step = 1e-6 * abs(truth).max() if floats else abs(truth[..., : found.shape[2]]) / 1024 + 1e-6
    assert (np.abs(found - truth[..., : found.shape[2]]) <= step).all()


def test_a_value_that_is_no_number_is_named(scene, bake, out, page):
    obj = monkey()
    transfer = bake(obj)
    gltf_export.write(str(out))
    first = transfer[7, 0, 0].tobytes()
    data = out.read_bytes()
    assert data.count(first) >= 1
    out.write_bytes(data.replace(first, np.float32(np.nan).tobytes()))
    said = page.run(LOOK, glb=out)
    assert said["plain"]
    assert "attribute _PRT_0 has a value that is no number" in said["problems"][0]


def test_a_file_without_a_bake_says_so(scene, out, page):
    monkey()
    bpy.ops.export_scene.gltf(filepath=str(out))
    assert page.run(LOOK, glb=out)["plain"]


FULL = {
    "order 5 and its peaks": {"order": 5, "turns": 1, "lights": 4},
    "order 4 in three channels": {"order": 4, "channels": 3, "turns": 1},
    "twelve turns": {"turns": 12},
    "no more than order 2": {"order": 2},
}


@pytest.mark.parametrize("stored", FULL.values(), ids=FULL)
def test_what_eevee_shows_fits_into_webgl(scene, bake, out, page, stored):
    """Up to 13 attributes, with position, texture coordinates and a colour."""
    bake(colored(COLORS[:1], "no material"), **stored)
    gltf_export.write(str(out))
    said = page.run(
        f"""
        const {{ stage }} = viewer;
        stage.resize(16, 16);
        const said = await (async () => {{ {LOOK} }})();
        stage.set({{ background: false }});
        stage.render();
        const {{ diagnostics }} = stage.renderer.info.programs.at(-1);
        return {{ ...said, diagnostics, error: stage.renderer.getContext().getError() }};
        """,
        glb=out,
    )
    assert said["problems"] == []
    assert not said["plain"]
    assert said.get("diagnostics") is None
    assert said["error"] == 0


def test_what_does_not_fit_is_shown_plain(scene, bake, out, page):
    bake(monkey(), order=4, channels=3, turns=1)
    gltf_export.write(str(out))
    body = f"""
        const {{ capabilities }} = viewer.stage.renderer, most = capabilities.maxAttributes;
        capabilities.maxAttributes = 12;
        try {{ {LOOK} }} finally {{ capabilities.maxAttributes = most; }}
    """
    said = page.run(body, glb=out)
    assert said["plain"]
    assert "14 vertex attributes, and WebGL has 12" in said["problems"][0]


def test_three_reads_the_attributes_that_are_in_the_file(scene, bake, out, page):
    """Against this suite's own reader, which shares nothing with three.js."""
    bake(rotated(), order=4, channels=3, turns=1, domain="CORNER")
    gltf_export.write(str(out))
    body = """
        await viewer.stage.loadModel(files.glb);
        const { geometry } = viewer.stage.primitives[0].mesh;
        const names = Object.keys(geometry.attributes).filter((name) => name.startsWith('_prt_'));
        return names.map((name) => [name, Array.from(geometry.attributes[name].array)]);
    """
    found = dict(page.run(body, glb=out))
    (attributes,) = Glb(out).attributes("Monkey")
    ours = {name: a for name, a in attributes.items() if name.startswith("_PRT")}
    assert len(ours) == len(found) == 13
    for name, values in ours.items():
        np.testing.assert_array_equal(np.float32(found[name.lower()]), values.ravel())


@pytest.mark.parametrize(
    ("name", "sentence"),
    [("a.png", "neither .glb, .hdr nor"), ("a.exr", "cannot be read"), ("a.hdr", "cannot be read")],
)
def test_a_bad_environment_is_one_sentence(page, tmp_path, name, sentence):
    path = tmp_path / name
    path.write_bytes(b"nothing of the kind, though long enough to be looked into")
    body = f"""
        const {{ read }} = await import('./environment.js');
        try {{ read('{name}', files.picture); }} catch (error) {{ return error.message; }}
        return 'read';
    """
    assert sentence in page.run(body, picture=path)


def baked_by_engine(obj):
    from prt_baker.addon import bake as baking
    from prt_baker.addon.prt.job import Settings

    for _ in baking.bake(bpy.context.scene.name, [obj.name], Settings(rays=16)):
        pass
