"""Real inputs baked from the command line: the demo under several HDRIs, and a scanned bust.

Prints a table in Markdown; ``make bench`` puts it into docs/benchmarks.md.
"""

import argparse
import base64
import json
import re
import subprocess
import sys
import time
from pathlib import Path

import bpy
import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1] / "tools"))
import demo_scene

ROOT = Path(__file__).parents[1]
HDRIS = ("sunset", "forest", "courtyard", "city")
HEADER = """| scene | points | triangles | Mrays | Mrays/s | whole command | noise at points \
| measured on the surface | EEVEE against Cycles |
|---|---|---|---|---|---|---|---|---|"""


def main() -> None:
    """A row for each input."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--cache", type=Path, default=ROOT / ".cache" / "bench")
    cache = parser.parse_args().cache
    print(HEADER)
    for hdri in HDRIS:
        print(demo_row(hdri, cache / hdri), flush=True)
    print(snowden_row(cache / "snowden"), flush=True)


def demo_row(hdri: str, folder: Path) -> str:
    """``make demo`` with another HDRI."""
    command = [sys.executable, ROOT / "tools" / "demo.py", "--hdri", hdri, "--out", folder]
    subprocess.run([*command, "--samples", "4"], check=True, stdout=subprocess.DEVNULL)
    figures = json.loads((folder / "figures.json").read_text())
    report = json.loads((folder / "report.json").read_text())
    return row(f"demo, {hdri}", report, figures["bake_seconds"], figures["picture_error"])


def snowden_row(folder: Path) -> str:
    """The bust of npm's ``snowden`` on a ground, with default settings."""
    folder.mkdir(parents=True, exist_ok=True)
    vertices, faces = snowden(folder)
    blend = folder / "snowden.blend"
    build(vertices, faces, blend)
    program = Path(sys.executable).with_name("prt-bake")
    start = time.perf_counter()
    outputs = ["--save", folder / "baked.blend", "--report", folder / "report.json", "--verify"]
    subprocess.run(
        [program, blend, "--object", "snowden", *outputs], check=True, capture_output=True
    )
    seconds = time.perf_counter() - start
    return row("snowden", json.loads((folder / "report.json").read_text()), seconds, None)


def snowden(folder: Path) -> tuple[np.ndarray, np.ndarray]:
    """Vertices (V, 3) and faces (F, 3) of the package's finer mesh, fetched once."""
    package = folder / "package" / "hi.js"
    if not package.exists():
        subprocess.run(
            ["npm", "pack", "snowden@1.0.1"], cwd=folder, check=True, capture_output=True
        )
        subprocess.run(["tar", "xzf", "snowden-1.0.1.tgz"], cwd=folder, check=True)
    found = dict(re.findall(r'exports\.(\w+) *=[^;]*?Array, *"([^"]*)"', package.read_text()))
    positions = np.frombuffer(base64.b64decode(found["positions"]), np.float32).reshape(-1, 3)
    cells = np.frombuffer(base64.b64decode(found["cells"]), np.uint32)
    return positions, cells.reshape(-1, 3).astype(np.int32)


def build(vertices: np.ndarray, faces: np.ndarray, path: Path) -> None:
    """A .blend with the bust, smooth, upright on a plane, under an HDRI."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    upright = vertices[:, [0, 2, 1]] * (1, -1, 1)
    size = np.ptp(upright, axis=0).max()
    low = upright.min(axis=0)
    mesh = bpy.data.meshes.new("snowden")
    mesh.from_pydata((upright - low) / size * 2, [], faces.tolist(), shade_flat=False)
    bust = bpy.data.objects.new("snowden", mesh)
    bpy.context.collection.objects.link(bust)
    bpy.ops.mesh.primitive_plane_add(size=8)
    demo_scene.add_world(bpy.context.scene, demo_scene.bundled_hdri("forest"), 0)
    bpy.ops.wm.save_as_mainfile(filepath=str(path.absolute()), relative_remap=False)


def row(name: str, report: dict, seconds: float, picture_error: float | None) -> str:
    """One line of the table; errors are pooled over the objects by their points."""
    objects = report["objects"]
    points = np.array([entry["points"] for entry in objects])
    rays = sum(entry["rays"] for entry in objects) / 1e6
    noise, surface = (
        np.sqrt((points * np.square(values)).sum() / points.sum())
        for values in (
            [entry["measured_error"]["at_points"] for entry in objects],
            [entry["measured_error"]["on_surface"] for entry in objects],
        )
    )
    picture = "" if picture_error is None else f"{100 * picture_error:.1f} %"
    cells = (
        name,
        f"{points.sum():,}",
        f"{report['occluder_triangles']:,}",
        f"{rays:.1f}",
        f"{rays / report['seconds']['transfer']:.1f}",
        f"{seconds:.1f} s",
        f"{100 * noise:.2f} %",
        f"{100 * surface:.2f} %",
        picture,
    )
    return f"| {' | '.join(cells)} |"


if __name__ == "__main__":
    main()
