"""Readers of others: three.js and Babylon.js find the same numbers in a file, with loaders of some
twenty lines."""

import json
import subprocess

import numpy as np
import pytest
from glb import Glb
from gltf_scenes import COLORS, colored, monkey, rotated
from gltf_validator import HERE, node_program
from prt_baker.addon import gltf_export, gltf_panel

BY_THREE = """
    const { GLTFLoader } = await import('three/addons/loaders/GLTFLoader.js');
    const { scene, parser } = await new GLTFLoader().parseAsync(files.glb, '');
    const found = {};
    scene.traverse((mesh) => {
      if (!mesh.isMesh) return;
      const { extras, primitives } = parser.json.meshes[parser.associations.get(mesh).meshes];
      const names = Object.keys(primitives[0].attributes).filter((name) => name.startsWith('_PRT_'));
      const values = (name) => {
        const { count, itemSize } = mesh.geometry.attributes[name.toLowerCase()];
        const get = (i) => mesh.geometry.attributes[name.toLowerCase()].getComponent(Math.floor(i / itemSize), i % itemSize);
        return Array.from({ length: count * itemSize }, (_, i) => get(i));
      };
      found[mesh.name] = { attributes: Object.fromEntries(names.map((name) => [name, values(name)])), prt: extras?.prt };
    });
    return found;
"""  # noqa: E501


def by_babylon(path):
    run = subprocess.run(
        [node_program(), str(HERE / "babylon.mjs"), str(path)],
        capture_output=True,
        text=True,
        check=True,
    )
    return json.loads(run.stdout)


def subdivided(bake):
    obj = rotated()
    obj.modifiers.new("Subdivision", "SUBSURF").levels = 2
    bake(obj, turns=1, by_modifier=True, smooth=True, bent=True)


FILES = {
    "floats": (lambda bake: bake(rotated(), order=4, channels=3, turns=1), False, None),
    "16 bits": (lambda bake: bake(rotated(), order=5, turns=1, lights=2), True, None),
    "clusters": (subdivided, False, 0.02),
    "two materials": (lambda bake: bake(colored(COLORS, "Dirt"), turns=12), False, None),
    "nothing baked": (lambda bake: monkey(), False, None),
}


@pytest.mark.parametrize("name", FILES)
@pytest.mark.usefixtures("registered")
def test_three_and_babylon_read_the_same(scene, bake, out, page, name):
    make, short, error = FILES[name]
    make(bake)
    with gltf_panel.chosen(scene, short, error):
        gltf_export.write(str(out))
    three, babylon = page.run(BY_THREE, glb=out), by_babylon(out)
    meshes = Glb(out).document["meshes"]
    count = sum(len(mesh["primitives"]) for mesh in meshes if "prt" in mesh.get("extras", {}))
    assert len(babylon) == count
    baked = [one for one in three.values() if one["attributes"]]
    assert len(baked) == count
    for ours, theirs in zip(baked, babylon.values(), strict=True):
        assert set(ours["attributes"]) == set(theirs["attributes"])
        for key, values in ours["attributes"].items():
            found = np.float32(theirs["attributes"][key])
            np.testing.assert_allclose(found, np.float32(values), rtol=1e-7, atol=1e-7)
            assert np.ptp(found) > 0
        assert ours["prt"] == theirs["prt"] is not None
