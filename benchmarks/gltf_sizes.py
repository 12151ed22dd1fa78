"""What a bake weighs in glTF, and how far 16-bit numbers are off: the table of docs/gltf.md.

Prints Markdown.  Few rays suffice: neither the size nor what rounding does depends on them.
"""

import argparse
import subprocess
import sys
from pathlib import Path

import numpy as np
import real_inputs

sys.path.insert(0, str(Path(__file__).parents[1] / "tools"))
sys.path.insert(0, str(Path(__file__).parents[1] / "tests" / "gltf"))
import demo_scene
from glb import Glb

ROOT = Path(__file__).parents[1]

BAKES = {
    "order 2": ("--order", "2"),
    "order 3": (),
    "order 3, one peak": ("--peaks", "1"),
    "order 3, 12 turns": ("--turns", "12"),
    "order 5": ("--order", "5"),
}
HEADER = """| scene | bake | vertices | bytes a vertex | MB | in 16 bits, MB \
| error of 16 bits, RMS | largest |
|---|---|---|---|---|---|---|---|"""


def main() -> None:
    """A row for every kind of bake of the demo, and one of a scanned bust."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--cache", type=Path, default=ROOT / ".cache" / "bench" / "gltf")
    cache = parser.parse_args().cache
    cache.mkdir(parents=True, exist_ok=True)
    demo_scene.build(demo_scene.bundled_hdri("sunset"), 60.0)
    real_inputs.bpy.ops.wm.save_as_mainfile(filepath=str(cache / "demo.blend"))
    print(HEADER)
    for name, options in BAKES.items():
        print(row("demo", name, cache / "demo.blend", options), flush=True)
    vertices, faces = real_inputs.snowden(cache)
    real_inputs.build(vertices, faces, cache / "snowden.blend")
    only = ("--object", "snowden")
    print(row("snowden", "order 3", cache / "snowden.blend", only), flush=True)


def row(scene: str, bake: str, blend: Path, options: tuple[str, ...]) -> str:
    """One line of the table; errors are relative to the RMS of what leaves a white surface."""
    exact, short = (exported(blend, (*options, *more)) for more in ((), ("--gltf-short",)))
    truth, found = (
        np.concatenate([seen(glb, name) for name in baked(glb)]) for glb in (exact, short)
    )
    size = np.sqrt(np.square(truth).mean())
    rms = np.sqrt(np.square(found - truth).mean()) / size
    widths = {4 * len(exact.prt(name)["layout"]) for name in baked(exact)}
    cells = (
        scene,
        bake,
        f"{len(truth):,}",
        " and ".join(str(width) for width in sorted(widths)),
        f"{weight(exact) / 1e6:.2f}",
        f"{weight(short) / 1e6:.2f}",
        f"{rms:.1e}",
        f"{np.abs(found - truth).max() / size:.1e}",
    )
    return f"| {' | '.join(cells)} |"


def exported(blend: Path, options: tuple[str, ...]) -> Glb:
    """The .glb of ``blend``, baked with ``options``."""
    program, glb = Path(sys.executable).with_name("prt-bake"), blend.with_suffix(".glb")
    command = [program, blend, "--rays", "64", *options, "--gltf", glb]
    subprocess.run(command, check=True, capture_output=True)
    return Glb(glb)


def baked(glb: Glb) -> list[str]:
    """The nodes of the file that have a bake."""
    return [name for name, node in glb.nodes.items() if "mesh" in node and glb.prt(name)]


def weight(glb: Glb) -> int:
    """Bytes of all bakes."""
    document = glb.document
    accessors = {
        accessor
        for mesh in document["meshes"]
        for primitive in mesh["primitives"]
        for name, accessor in primitive["attributes"].items()
        if name.startswith("_PRT_")
    }
    views = (document["accessors"][a]["bufferView"] for a in accessors)
    return sum(document["bufferViews"][view]["byteLength"] for view in views)


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
    from prt_baker.addon.prt.job import Peak
    from prt_baker.addon.prt.light import residual

    peak = Peak(tuple(lamp["direction"]), tuple(lamp["irradiance"]), lamp["angular_radius"])
    return residual.peaks_sh((peak,))[: order**2]


if __name__ == "__main__":
    main()
