"""Images for engines beside a texture, and meshes that had no UV map before."""

import json
from dataclasses import replace

import bpy
import numpy as np
import pytest
import snapshot
import textured
from bakes import add, link, principled, quad, shader
from pictures import colour, look_down, render
from prt_baker.addon import remove
from prt_baker.addon.atlas_files import Target
from prt_baker.addon.prt.errors import BakeError
from prt_baker.addon.prt.files.atlases import read_tiles
from prt_baker.addon.prt.files.images import read_rgba
from test_textures import FEW, LAYOUT, baked, marks, saved, stage
from worlds import environment, generated, picture


class TestImagesForEngines:
    FILES = {
        "exr": ["room PRT.exr", "room PRT_0.exr", "room PRT_1.exr", "room PRT_2.exr"],
        "png": ["room PRT.exr", "room PRT.json", *(f"room PRT_{k}.png" for k in range(3))],
    }

    @pytest.mark.parametrize("kind", FILES)
    def test_they_lie_beside_the_texture_and_hold_the_same(self, scene, tmp_path, kind):
        names = stage(scene)
        target = saved(scene, tmp_path)
        for seed in (1, 2):
            baked(scene, names, target, replace(FEW, seed=seed, engine_images=kind))
        found = {path.name: path for path in tmp_path.iterdir() if path.suffix != ".blend"}
        assert sorted(found) == self.FILES[kind]
        values, columns = read_tiles(found["room PRT.exr"])
        assert len(columns) == 12
        if kind == "exr":
            pixels, texts = read_rgba(str(found["room PRT_2.exr"]))
            assert texts["prtBaker"] == marks(*names)[0].job_hash
            np.testing.assert_array_equal(pixels[::-1], values[:, :, 8:])
        else:
            said = json.loads(found["room PRT.json"].read_text("utf-8"))["images"]
            assert [name for image in said for name in image["prtColumns"]] == list(columns)
            assert said[0]["offset"][0] == pytest.approx(values[..., 0].min())

    def test_a_picture_of_the_artists_in_their_place_stays(self, scene, tmp_path):
        names = stage(scene)
        target = saved(scene, tmp_path)
        state = snapshot.of(scene)
        (tmp_path / "room PRT_1.png").write_bytes(b"a painting")
        with pytest.raises(BakeError, match="is a picture of yours"):
            baked(scene, names, target, replace(FEW, engine_images="png"))
        assert snapshot.of(scene) == state
        assert sorted(path.name for path in tmp_path.iterdir()) == ["room PRT_1.png", "room.blend"]

    def test_they_need_a_folder(self, scene):
        names = stage(scene)
        with pytest.raises(BakeError, match="Images for engines are files"):
            baked(scene, names, Target("texture"), replace(FEW, engine_images="exr"))


class TestMeshesWithoutUvMaps:
    def test_what_reads_the_first_uv_map_goes_on_to_find_none(self, scene, tmp_path):
        """A picture that nothing is plugged into, on a mesh of its own and behind a modifier."""
        material = principled()
        texture = add(material, "TexImage")
        texture.image = bpy.data.images.new("Mine", 8, 8, float_buffer=True)
        pixels = np.ones((8, 8, 4), np.float32)
        pixels[..., 0] = np.linspace(0, 1, 8)
        texture.image.pixels.foreach_set(pixels.ravel())
        texture.image.pack()
        link(material, texture.outputs[0], shader(material).inputs["Base Color"])
        objects = [quad(scene, 0, 0, material), quad(scene, 1, 0, material)]
        objects[1].modifiers.new("Subdivision", "SUBSURF").subdivision_type = "SIMPLE"
        environment(scene, generated(picture()))
        look_down(scene, 2, 1)
        before = colour(render(scene, tmp_path, "CYCLES"), "Combined")
        for seed in (0, 1):
            textured.write(scene, tmp_path, LAYOUT, *objects, seed=seed)
            layers = objects[0].data.uv_layers
            assert [layer.name for layer in layers] == ["PRT Empty", "PRT"]
            assert layers.active.name == "PRT Empty"
            assert layers["PRT Empty"].active_render
        after = colour(render(scene, tmp_path, "CYCLES"), "Combined")
        np.testing.assert_allclose(after, before, rtol=1e-4)

    def test_a_map_that_the_artist_makes_later_stays(self, scene, tmp_path):
        obj = quad(scene, material=principled())
        textured.write(scene, tmp_path, LAYOUT, obj)
        obj.data.uv_layers.new(name="Mine").active_render = True
        textured.write(scene, tmp_path, LAYOUT, obj, seed=1)
        assert [layer.name for layer in obj.data.uv_layers] == ["Mine", "PRT"]
        assert obj.data.uv_layers["Mine"].active_render
        remove.remove(scene, [obj])
        assert [layer.name for layer in obj.data.uv_layers] == ["Mine"]
