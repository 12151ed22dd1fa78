"""What a baked object says of its bake: ``object["prt_stamp"]`` (JSON) and ``object["prt_baked"]``.

``prt_baked`` is the switch that the materials read: 1.0 shows the bake, 0.0 (a stale bake) and a
missing one (never baked) show the artist's shader.
"""

import json
from dataclasses import asdict, dataclass
from functools import lru_cache

import bpy

from .prt.layout import Layout

KEY = "prt_stamp"
SWITCH = "prt_baked"
VERSION = 1


@dataclass(frozen=True)
class Stamp:
    """``matrix`` is the object's world 3x3, column-major, and ``location`` its place when baked;
    ``mesh_signature`` names the mesh data that was baked; ``job_hash`` everything that decided the
    result; errors are relative RMS of the transfer, None where unknown."""

    order: int
    channels: int
    layout: tuple[str, ...]
    carrier: str
    domain: str
    by_modifier: bool
    job_hash: str
    mesh_signature: str
    matrix: tuple[float, ...]
    location: tuple[float, ...]
    points: int
    rays: int
    mrays_per_second: float
    estimated_error: float | None = None
    measured_error: float | None = None
    version: int = VERSION

    @property
    def packing(self) -> Layout:
        """The layout that its attributes have."""
        lights = sum(name.startswith("S") for name in self.layout)
        return Layout(self.order, self.channels, "R0r" in self.layout, lights)


def read(obj: bpy.types.Object) -> Stamp | None:
    """The stamp of ``obj``; None where it was never baked, or by a version that we don't know."""
    text = obj.get(KEY)
    return _parse(text) if isinstance(text, str) else None


@lru_cache(maxsize=1024)
def _parse(text: str) -> Stamp | None:
    """Kept, because handlers and panels ask at every change and every redraw."""
    values = json.loads(text)
    if values.get("version") != VERSION:
        return None
    for name in ("layout", "matrix", "location"):
        values[name] = tuple(values[name])
    return Stamp(**values)


def write(obj: bpy.types.Object, stamp: Stamp) -> None:
    """Stamp ``obj`` and switch its bake on."""
    obj[KEY] = json.dumps(asdict(stamp))
    switch(obj, on=True)


def switch(obj: bpy.types.Object, on: bool) -> None:
    """Show the bake, or the artist's shader; touches nothing that is already so."""
    value = 1.0 if on else 0.0
    if obj.get(SWITCH) != value:
        obj[SWITCH] = value
        obj.update_tag()


def remove(obj: bpy.types.Object) -> None:
    """Take stamp and switch away."""
    for key in (KEY, SWITCH):
        if key in obj:
            del obj[key]
    obj.update_tag()


def baked_objects(scene: bpy.types.Scene) -> list[bpy.types.Object]:
    """The objects of ``scene`` that carry a bake."""
    return [obj for obj in scene.objects if KEY in obj]
