"""make demo: bake a scene with the defaults, render it in EEVEE and, as the truth, in Cycles.

Writes the .blend, the .glb, the report and the pictures into ``demo/``.
"""

import argparse
import json
import os
import subprocess
import sys
import time
from pathlib import Path

import bpy
import demo_scene
import numpy as np
from prt_baker.addon.prt.files import images

WIDTH, HEIGHT, SAMPLES = 640, 360, 64


def main() -> None:
    """Everything that ``make demo`` promises."""
    asked = _arguments()
    start = time.perf_counter()
    asked.out.mkdir(parents=True, exist_ok=True)
    blend = asked.out / "scene.blend"
    demo_scene.build(demo_scene.bundled_hdri(asked.hdri), asked.turn)
    bpy.ops.wm.save_as_mainfile(filepath=str(blend.absolute()), relative_remap=False)
    baked = asked.out / "demo.blend"
    before_bake = time.perf_counter()
    report = _bake(blend, baked, asked)
    bake_seconds = time.perf_counter() - before_bake
    bpy.ops.wm.open_mainfile(filepath=str(baked.absolute()))
    eevee, cycles = render_eevee(asked.out, asked.samples), render_cycles(asked.out)
    _write_pictures(asked.out, eevee, cycles)
    error = float(np.sqrt(((eevee - cycles) ** 2).mean() / (cycles**2).mean()))
    figures = {"bake_seconds": bake_seconds, "picture_error": error}
    (asked.out / "figures.json").write_text(json.dumps(figures))
    _print_figures(report, figures, asked.out)
    print(f"{time.perf_counter() - start:.0f} s")
    _leave()


def _arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--hdri", default="sunset", help="one of Blender's bundled HDRIs")
    parser.add_argument("--turn", type=float, default=60.0, help="turn of the world in degrees")
    parser.add_argument("--samples", type=int, default=16, help="samples of EEVEE")
    parser.add_argument("--out", type=Path, default=Path("demo"), help="folder to write")
    return parser.parse_args()


def _bake(blend: Path, baked: Path, asked: argparse.Namespace) -> dict:
    program = Path(sys.executable).with_name("prt-bake")
    outputs = ["--save", baked, "--gltf", asked.out / "demo.glb"]
    outputs += ["--report", asked.out / "report.json", "--verify"]
    subprocess.run([program, blend, *outputs], check=True)
    return json.loads((asked.out / "report.json").read_text())


def render_eevee(folder: Path, samples: int) -> np.ndarray:
    """The picture that EEVEE shows through the node group, linear (H, W, 3)."""
    scene = bpy.context.scene
    scene.render.engine = "BLENDER_EEVEE_NEXT" if bpy.app.version < (5, 0) else "BLENDER_EEVEE"
    scene.eevee.taa_render_samples = samples
    return _render(folder / "eevee.exr")


def render_cycles(folder: Path) -> np.ndarray:
    """The truth, linear (H, W, 3): the same world, diffuse light, no bounces."""
    scene = bpy.context.scene
    scene.render.engine = "CYCLES"
    scene.cycles.samples = SAMPLES
    scene.cycles.max_bounces = 0
    scene.cycles.use_denoising = False
    return _render(folder / "cycles.exr")


def _render(path: Path) -> np.ndarray:
    scene = bpy.context.scene
    scene.render.resolution_x, scene.render.resolution_y = WIDTH, HEIGHT
    scene.render.resolution_percentage = 100
    scene.render.image_settings.file_format = "OPEN_EXR"
    scene.render.image_settings.color_depth = "32"
    scene.render.filepath = str(path.absolute())
    bpy.ops.render.render(write_still=True)
    return images.read(str(path))


def _write_pictures(folder: Path, eevee: np.ndarray, cycles: np.ndarray) -> None:
    _save_png(folder / "eevee.png", eevee)
    _save_png(folder / "cycles.png", cycles)
    difference = np.abs(eevee - cycles).mean(axis=2, keepdims=True)
    _save_png(folder / "compare.png", np.hstack([eevee, cycles, np.repeat(difference, 3, axis=2)]))


def _save_png(path: Path, linear: np.ndarray) -> None:
    """``linear`` (H, W, 3), top row first, as an 8-bit picture in the standard view."""
    height, width = linear.shape[:2]
    image = bpy.data.images.new(path.stem, width, height, float_buffer=True)
    pixels = np.ones((height, width, 4), np.float32)
    pixels[..., :3] = linear[::-1]
    image.pixels.foreach_set(pixels.ravel())
    scene = bpy.context.scene
    scene.view_settings.view_transform = "Standard"
    scene.render.image_settings.file_format = "PNG"
    scene.render.image_settings.color_depth = "8"
    image.save_render(str(path.absolute()), scene=scene)
    bpy.data.images.remove(image)


def _print_figures(report: dict, figures: dict, folder: Path) -> None:
    points = sum(entry["points"] for entry in report["objects"])
    rays = sum(entry["rays"] for entry in report["objects"])
    trace = report["seconds"]["transfer"]
    error = 100 * figures["picture_error"]
    print(f"{points:,} points, {rays / 1e6:.1f} Mrays, {rays / trace / 1e6:.1f} Mrays/s")
    print(f"EEVEE against Cycles: {error:.1f} % relative RMS of the whole picture")
    print(f"{folder.absolute()}: {', '.join(sorted(p.name for p in folder.iterdir()))}")


def _leave() -> None:
    """Blender may crash in its own clean-up at exit; everything is written by now."""
    sys.stdout.flush()
    os._exit(0)


if __name__ == "__main__":
    main()
