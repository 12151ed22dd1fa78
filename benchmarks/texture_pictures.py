"""Pictures of a room and of a scanned bust whose light lies in textures of 1024 x 1024, in EEVEE.

Looked at for light that leaks along the partition, dark lines along edges, seams and unbaked
texels.  Each view is also rendered as from far away, where EEVEE reads halvings of the texture, and
compared with the large picture made smaller.
"""

import argparse
import sys
from pathlib import Path
from tempfile import TemporaryDirectory

import bpy
import numpy as np
import picture_bakes
import picture_files
import picture_truth
from mathutils import Vector
from picture_truth import Picture
from prt_baker.addon import bake
from prt_baker.addon.atlas_files import Target
from prt_baker.addon.prt.job import Settings

sys.path.insert(0, str(Path(__file__).parents[1] / "tools"))
sys.path.insert(0, str(Path(__file__).parents[1] / "tests" / "engine"))
import demo_scene
import real_inputs
import rooms

IMAGES = Path(__file__).parents[1] / "docs" / "images"
WIDTH, HEIGHT = 720, 480
SAMPLES = 8
FAR = (4, 8, 16, 32)  # times as far away
View = tuple[tuple[float, float, float], tuple[float, float, float], float]  # eye, target, mm


def room() -> tuple[str, tuple[View, ...]]:
    """A room with a window, a partition, an open door and furniture."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    inner, outer = rooms.shell()
    seen = rooms.shapes.join(inner, *rooms.furniture())
    for name, mesh in (("Room", seen), ("Outside", outer)):
        demo_scene.add_mesh(name, *mesh).data.shade_flat()
    demo_scene.add_world(bpy.context.scene, demo_scene.bundled_hdri("courtyard"), 0)
    views = (
        ((3.3, 0.4, 1.7), (1.4, 2.6, 0.6), 22),
        ((5.7, 0.4, 1.8), (3.9, 2.4, 0.4), 22),
        ((2.6, 1.6, 0.9), (3.6, 3.3, 0.3), 22),
    )
    return "Room", views


def snowden(cache: Path) -> tuple[str, tuple[View, ...]]:
    """The scanned bust of npm's ``snowden`` on a plane."""
    cache.mkdir(parents=True, exist_ok=True)
    real_inputs.build(*real_inputs.snowden(cache), cache / "texture-pictures.blend")
    views = (((0.6, -2.6, 1.5), (0.6, 0.5, 1.0), 35), ((2.4, -0.9, 1.7), (0.6, 0.5, 1.15), 45))
    return "snowden", views


def baked(name: str, size: int) -> str:
    """Bake the object into a texture; what the report says of it."""
    settings, target = Settings(resolution=size, tolerance=0.01, cache=""), Target("texture")
    steps = bake.bake(bpy.context.scene.name, [name], settings, target=target)
    while True:
        try:
            next(steps)
        except StopIteration as stop:
            (entry,) = stop.value["objects"]
            seconds = stop.value["wall_seconds"]
            break
    return (
        f"{entry['points']:,} texels, {entry['rays'] / 1e6:.0f} M rays, {seconds:.0f} s, "
        f"error about {entry['surface_error']:.2%}"
    )


def look(view: View) -> None:
    """Set the camera up."""
    scene, (eye, to, lens) = bpy.context.scene, view
    if scene.camera is None:
        scene.camera = bpy.data.objects.new("Camera", bpy.data.cameras.new("Camera"))
        scene.collection.objects.link(scene.camera)
    scene.camera.location, scene.camera.data.lens = eye, lens
    scene.camera.data.clip_start = 0.01
    ahead = Vector(to) - Vector(eye)
    scene.camera.rotation_euler = ahead.to_track_quat("-Z", "Y").to_euler()


def shown(folder: Path, times: int = 1, samples: int = SAMPLES) -> Picture:
    """What EEVEE shows (H, W, 3), as many ``times`` smaller."""
    render = bpy.context.scene.render
    render.resolution_x, render.resolution_y = WIDTH // times, HEIGHT // times
    render.resolution_percentage = 100
    channels = picture_truth.eevee(folder, samples)
    return picture_truth.colour(channels)


def smaller(picture: Picture, times: int) -> Picture:
    """The means of squares of ``times`` x ``times`` pixels."""
    height, width = picture.shape[0] // times, picture.shape[1] // times
    cut = picture[: height * times, : width * times]
    return cut.reshape(height, times, width, times, 3).mean(axis=(1, 3))


def main() -> None:
    """Draw both and print how far the small pictures are off."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--scene", choices=("room", "snowden"), action="append")
    parser.add_argument("--size", type=int, default=1024)
    parser.add_argument("--out", type=Path, default=IMAGES)
    given = parser.parse_args()
    with TemporaryDirectory() as temporary, picture_bakes.add_on():
        folder = Path(temporary)
        for scene in given.scene or ("room", "snowden"):
            name, views = room() if scene == "room" else snowden(folder / "snowden")
            print(f"{scene}: {baked(name, given.size)}", flush=True)
            panels, far = [], []
            for view in views:
                look(view)
                panels.append(shown(folder))
                far.append([off(shown(folder, times, 1), panels[-1], times) for times in FAR])
            for times, found in zip(FAR, np.max(far, axis=0), strict=True):
                print(
                    f"{times} times as far: off by {found[0]:.1%} in the mean, {found[1]:.0%} most"
                )
            scaled = [0.9 * panel / np.quantile(panel, 0.98) for panel in panels]
            picture_files.save(given.out / f"textures-{scene}.jpg", np.hstack(scaled))


def off(small: Picture, large: Picture, times: int) -> tuple[float, float]:
    """How far what is ``small`` is off the ``large`` one made smaller, where that is smooth: the
    mean and the most, relative."""
    height, width = small.shape[:2]
    whole = smaller(large, times)[:height, :width]
    squares = smaller(large**2, times)[:height, :width] - whole**2
    smooth = squares.sum(axis=2) < (0.05 * whole.sum(axis=2)) ** 2
    away = np.abs(small[: len(whole), : whole.shape[1]] - whole).sum(axis=2)
    away /= np.maximum(whole.sum(axis=2), 1e-3 * whole.sum(axis=2).mean())
    return float(away[smooth].mean()), float(away[smooth].max())


if __name__ == "__main__":
    main()
