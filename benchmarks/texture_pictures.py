"""Pictures of a room and of a scanned bust whose light lies in textures of 1024 x 1024, in EEVEE;
in the room light bounces three times.

Looked at for light that leaks along the partition, dark lines along edges, seams and unbaked
texels.  Below, each view in eight and twenty-four times fewer pixels along a side, where EEVEE
reads halvings of the texture as it does from far away.
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
from prt_baker.addon.prt.steps import value_of

sys.path.insert(0, str(Path(__file__).parents[1] / "tools"))
sys.path.insert(0, str(Path(__file__).parents[1] / "tests" / "engine"))
import demo_scene
import real_inputs
import rooms

IMAGES = Path(__file__).parents[1] / "docs" / "images"
WIDTH, HEIGHT = 720, 480
SAMPLES = 4
BOUNCES = {"room": 3, "snowden": 0}
FAR = (8, 24)  # times fewer pixels along a side
View = tuple[tuple[float, float, float], tuple[float, float, float], float]  # eye, target, mm


def room() -> tuple[str, tuple[View, ...]]:
    """A room with a window, a partition, an open door and furniture."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    inner, outer = rooms.shell()
    seen = rooms.shapes.join(inner, *rooms.furniture())
    for name, mesh in (("Room", seen), ("Outside", outer)):
        demo_scene.add_mesh(name, *mesh).data.shade_flat()
    demo_scene.add_world(bpy.context.scene, demo_scene.bundled_hdri("forest"), 0)
    views = (
        ((3.3, 0.4, 1.7), (1.4, 2.6, 0.6), 22),
        ((5.8, 0.3, 2.2), (3.75, 1.3, 0.3), 20),
        ((2.62, 1.6, 0.9), (3.6, 3.3, 0.3), 22),  # in no plane of a leg: Mesa draws such askew
    )
    return "Room", views


def snowden(cache: Path) -> tuple[str, tuple[View, ...]]:
    """The scanned bust of npm's ``snowden`` on a plane."""
    cache.mkdir(parents=True, exist_ok=True)
    real_inputs.build(*real_inputs.snowden(cache), cache / "texture-pictures.blend")
    views = (((0.6, -2.6, 1.5), (0.6, 0.5, 1.0), 35), ((2.4, -0.9, 1.7), (0.6, 0.5, 1.15), 45))
    return "snowden", views


def baked(name: str, size: int, bounces: int) -> str:
    """Bake the object into a texture; what the report says of it."""
    settings = Settings(resolution=size, tolerance=0.01, cache="", bounces=bounces)
    steps = bake.bake(bpy.context.scene.name, [name], settings, target=Target("texture"))
    report = value_of(steps)
    (entry,) = report["objects"]
    return (
        f"{entry['points']:,} texels, {entry['rays'] / 1e6:.0f} M rays, "
        f"{report['wall_seconds']:.0f} s, error about {entry['surface_error']:.2%}"
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


def panel(folder: Path) -> Picture:
    """What is seen, and below it, each half as large, what is seen from farther away."""
    near = shown(folder)
    half = [np.kron(shown(folder, times, 1), np.ones((times // 2, times // 2, 1))) for times in FAR]
    whole = np.vstack([near, np.hstack(half)])
    return np.asarray(0.9 * whole / np.quantile(near, 0.98), np.float32)


def main() -> None:
    """Draw both and print how far the small pictures are off."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--scene", choices=tuple(BOUNCES), action="append")
    parser.add_argument("--size", type=int, default=1024)
    parser.add_argument("--out", type=Path, default=IMAGES)
    given = parser.parse_args()
    with TemporaryDirectory() as temporary, picture_bakes.add_on():
        folder = Path(temporary)
        for scene in given.scene or BOUNCES:
            name, views = room() if scene == "room" else snowden(folder / "snowden")
            print(f"{scene}: {baked(name, given.size, BOUNCES[scene])}", flush=True)
            panels = []
            for view in views:
                look(view)
                panels.append(panel(folder))
            picture_files.save(given.out / f"textures-{scene}.jpg", np.hstack(panels))


if __name__ == "__main__":
    main()
