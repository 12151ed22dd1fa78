"""What a bake weighs in glTF in each of its forms, and how far these are off: the tables of
docs/gltf.md.

Prints Markdown.  Few rays suffice: neither the size nor what rounding does depends on them; noise
compresses worse than light, so of clusters it says rather too much.
"""

import argparse
import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import prt_baker
import real_inputs

sys.path.insert(0, str(Path(__file__).parents[1] / "tools"))
sys.path.insert(0, str(Path(__file__).parents[1] / "tests" / "gltf"))
import demo_scene
from glb import Glb
from prt_baker.addon import atlas_images, gltf, gltf_export, gltf_panel, light_state, stamp
from prt_baker.addon.prt import layout as layouts
from prt_baker.addon.prt import sh
from prt_baker.addon.prt.job import Peak
from prt_baker.addon.prt.light import residual

ROOT = Path(__file__).parents[1]
bpy = real_inputs.bpy

RAYS = ("--rays", "64")
ON_VERTICES = {
    "order 2": ("--order", "2"),
    "order 3": (),
    "order 3, no residual": ("--no-residual",),
    "order 3, one peak": ("--peaks", "1"),
    "order 3, 12 turns": ("--turns", "12"),
    "order 5": ("--order", "5"),
}
USUAL = 0.01  # the error that clusters are asked for
ERRORS = (0.05, 0.02, USUAL, 0.005)  # and others, of the bakes
CURVES = ("order 3", "order 5")
IN_TEXTURES = ("order 3", "order 3, no residual", "order 5")
TEXTURE = ("--carrier", "texture", "--resolution", "1024")
HEADER = """| scene | bake | bytes a vertex | floats, MB | 16 bits, MB | error, RMS | largest \
| clusters for 1 %, MB | error, RMS | largest |
|---|---|---|---|---|---|---|---|---|---|"""
CURVE = """| scene | bake | asked for | MB | bytes a vertex | error, RMS | largest |
|---|---|---|---|---|---|---|"""
TEXTURES = """| scene | bake | texels | pictures | MB | as float32, MB | error, RMS | largest |
|---|---|---|---|---|---|---|---|"""


def main() -> None:
    """The tables of the demo and of a scanned bust."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--cache", type=Path, default=ROOT / ".cache" / "bench" / "gltf")
    cache = parser.parse_args().cache
    cache.mkdir(parents=True, exist_ok=True)
    demo_scene.build(demo_scene.bundled_hdri("sunset"), 60.0)
    bpy.ops.wm.save_as_mainfile(filepath=str(cache / "demo.blend"))
    vertices, faces = real_inputs.snowden(cache)
    real_inputs.build(vertices, faces, cache / "snowden.blend")
    prt_baker.register()
    scenes = {"demo": (), "snowden": ("--object", "snowden")}
    curves = []
    print(HEADER)
    for scene, its in scenes.items():
        for name, options in ON_VERTICES.items():
            bake(cache / f"{scene}.blend", (*options, *its))
            asked = ERRORS if name in CURVES else (USUAL,)
            small = {error: compressed(cache, error) for error in asked}
            print(
                f"| {scene} | {name} | {' | '.join(on_vertices(cache, small[USUAL]))} |", flush=True
            )
            if name in CURVES:
                curves += [f"| {scene} | {name} | {line} |" for line in curve(small)]
    print(f"\n{CURVE}", *curves, f"\n{TEXTURES}", sep="\n", flush=True)
    for scene, its in scenes.items():
        for name in IN_TEXTURES:
            bake(cache / f"{scene}.blend", (*TEXTURE, *ON_VERTICES[name], *its))
            print(f"| {scene} | {name} | {' | '.join(in_texture(cache))} |", flush=True)
    prt_baker.unregister()


def bake(blend: Path, options: tuple[str, ...]) -> None:
    """Bake ``blend`` and open the result."""
    program, out = Path(sys.executable).with_name("prt-bake"), blend.with_name("baked.blend")
    command = [program, blend, *RAYS, *options, "--save", out]
    subprocess.run(command, check=True, capture_output=True)
    bpy.ops.wm.open_mainfile(filepath=str(out))


def written(cache: Path, short: bool = False, error: float = 0.0) -> Glb:
    """The .glb of the open file."""
    path = cache / "baked.glb"
    with gltf_panel.chosen(bpy.context.scene, short, error or None):
        gltf_export.write(str(path))
    return Glb(path)


def compressed(cache: Path, error: float) -> list[str]:
    """Cells of the open file in clusters: MB, bytes a vertex, the error, RMS and the largest."""
    truth = light_of(written(cache))
    small = written(cache, error=error)
    coded = sum(entry["chosen"] is not None for entry in gltf.REPORT)
    print(f"  ({coded} of {len(gltf.REPORT)} meshes in clusters)", file=sys.stderr)
    size = weight(small)
    return [f"{size / 1e6:.2f}", f"{size / len(truth):.1f}", *errors(light_of(small), truth)]


def on_vertices(cache: Path, small: list[str]) -> list[str]:
    """The cells of one bake, which in clusters are ``small``."""
    exact, short = written(cache), written(cache, short=True)
    truth = light_of(exact)
    widths = {4 * len(exact.prt(name)["layout"]) for name in baked(exact)}
    return [
        " and ".join(str(width) for width in sorted(widths)),
        f"{weight(exact) / 1e6:.2f}",
        f"{weight(short) / 1e6:.2f}",
        *errors(light_of(short), truth),
        small[0],
        *small[2:],
    ]


def curve(small: dict[float, list[str]]) -> list[str]:
    """Cells of bytes against errors."""
    return [" | ".join((f"{100 * error:g} %", *cells)) for error, cells in small.items()]


def in_texture(cache: Path) -> list[str]:
    """The cells of one bake; errors are over all texels."""
    glb = written(cache)
    name = baked(glb)[0]
    mark = stamp.read(bpy.data.objects[name])
    image, state = stamp.image_of(bpy.data.objects[name]), light_state.read(bpy.context.scene)
    stored = atlas_images.columns(image, len(mark.packing.attributes))[::-1]
    values = layouts.unpack(mark.packing, stored.reshape(-1, stored.shape[2]))
    truth = residual.shaded(values.transfer, state.baked_radiance_sh)
    truth += values.residual.sum(axis=1)
    slots = glb.prt(name)["layout"]
    numbers = glb.atlas(name).reshape(len(truth), -1)
    y_up = np.array([[1, 0, 0], [0, 0, 1], [0, -1, 0]])
    light = sh.rotate(state.baked_radiance_sh, y_up)[: mark.order**2]
    found = numbers[:, [slots.index(f"T{i}") for i in range(mark.order**2)]] @ light
    if "R0r" in slots:
        found += numbers[:, [slots.index(f"R0{c}") for c in "rgb"]]
    images = glb.document["images"]
    views = [glb.document["bufferViews"][image["bufferView"]] for image in images]
    return [
        f"{len(stored)}²",
        str(len(images)),
        f"{sum(view['byteLength'] for view in views) / 1e6:.2f}",
        f"{4 * len(mark.layout) * len(truth) / 1e6:.2f}",
        *errors(np.maximum(found, 0), np.maximum(truth, 0)),
    ]


def errors(found: np.ndarray, truth: np.ndarray) -> list[str]:
    """RMS and the largest, relative to the RMS of what leaves a white surface."""
    size = np.sqrt(np.square(truth).mean())
    rms, largest = np.sqrt(np.square(found - truth).mean()), np.abs(found - truth).max()
    return [f"{rms / size:.1e}", f"{largest / size:.1e}"]


def light_of(glb: Glb) -> np.ndarray:
    """What leaves all vertices, (E, 3)."""
    return np.concatenate([seen(glb, name) for name in baked(glb)])


def baked(glb: Glb) -> list[str]:
    """The nodes of the file that have a bake."""
    return [name for name, node in glb.nodes.items() if "mesh" in node and glb.prt(name)]


def weight(glb: Glb) -> int:
    """Bytes of all bakes, clusters as JSON has them."""
    document = glb.document
    accessors = {
        accessor
        for mesh in document["meshes"]
        for primitive in mesh["primitives"]
        for name, accessor in primitive["attributes"].items()
        if name.startswith("_PRT_")
    }
    views = (document["accessors"][a]["bufferView"] for a in accessors)
    clusters = (
        mesh.get("extras", {}).get("prt", {}).get("clusters") for mesh in document["meshes"]
    )
    texts = sum(len(json.dumps(one, separators=(",", ":"))) for one in clusters if one)
    return texts + sum(document["bufferViews"][view]["byteLength"] for view in views)


def seen(glb: Glb, name: str) -> np.ndarray:
    """Exit radiance (E, 3) of a white surface under the baked light, where all weights are 1 and
    none of the other turns shows."""
    prt = glb.prt(name)
    (light,) = (s["extras"]["prt_light"] for s in glb.document["scenes"] if "extras" in s)
    coefficients = np.array(light["baked_radiance_sh"])[: prt["order"] ** 2]
    total = glb.transfer(name)[:, 0] @ coefficients
    if "R0r" in prt["layout"]:
        total += glb.slots(name, ["R0r", "R0g", "R0b"])
    for j, lamp in enumerate(light["lights"]):
        if f"S{j}" in prt["layout"]:
            total += glb.slots(name, [f"S{j}"]) * np.array(lamp["irradiance"]) / np.pi
            total -= glb.transfer(name)[:, 0] @ disc(lamp, prt["order"])
    return np.maximum(total, 0)


def disc(lamp: dict, order: int) -> np.ndarray:
    """Coefficients (n², 3) of a cut-out light."""
    peak = Peak(tuple(lamp["direction"]), tuple(lamp["irradiance"]), lamp["angular_radius"])
    return residual.peaks_sh((peak,))[: order**2]


if __name__ == "__main__":
    main()
