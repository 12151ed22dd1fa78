"""What a baked object says of its bake: ``object["prt_stamp"]`` (JSON) and two numbers that the
materials read.

``prt_baked`` is a switch: 1.0 shows the bake, 0.0 (a stale bake) and a missing one (never baked)
show the artist's shader.  ``prt_exact`` is the share of the stored residual that belongs to the
scene's baked light: 1.0 where the object was baked under that very light, and 0.0 or missing where
it was under another one, so that it shows the spherical harmonics alone.
"""

import json
from collections import Counter
from dataclasses import asdict, dataclass
from functools import lru_cache
from math import isqrt

import bpy

from .prt.layout import DIRECT, PREFIX, Layout

KEY = "prt_stamp"
SWITCH = "prt_baked"
EXACT = "prt_exact"
ATLAS = "prt_image"  # the image of an object whose bake is in one
MARKS = (KEY, SWITCH, EXACT, ATLAS)
VERSION = 3
READABLE = (1, 2, VERSION)


@dataclass(frozen=True)
class Stamp:
    """``matrix`` is the object's world 3x3, column-major, and ``location`` its place when baked;
    ``mesh_signature`` names the mesh data that was baked; ``job_hash`` everything that decided the
    result; ``rays`` are those a point; ``points`` are texels where the ``carrier`` is "texture",
    in an atlas of ``atlas_size`` texels a side, and ``own_uvs`` says that its UV map is the
    artist's, ``uv_key`` otherwise what atlas it was made for.  ``why`` this carrier was chosen,
    where the artist left it open.

    Errors are relative RMS, None where unknown.  Of the transfer: ``estimated_error`` is the noise
    that it shows, ``interpolation_error`` what the mesh loses between its vertices,
    ``measured_error`` both, as *Verify* found them, and ``measured_at_points`` the noise alone.
    Of the light that leaves a white surface: ``light_error`` as measured where the world is
    ``light_at_bake`` (else it was another one by then), and ``plain_error``, what the light's order
    leaves out where no residual mends it.  Of what points see, where that is stored:
    ``visibility_error`` as measured.
    ``bounces`` are those that were asked for, and ``direct`` is whether the light without them
    was kept."""

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
    interpolation_error: float | None = None
    measured_at_points: float | None = None
    light_error: float | None = None
    light_at_bake: bool = True
    plain_error: float | None = None
    visibility_error: float | None = None
    atlas_size: int = 0
    own_uvs: bool = False
    uv_key: str = ""
    why: str = ""
    bounces: int = 0
    direct: bool = False
    version: int = VERSION

    @property
    def packing(self) -> Layout:
        """The layout that its attributes have."""
        letters = Counter(name[:1] for name in self.layout)
        seen = isqrt(letters["V"])
        return Layout(self.order, self.channels, letters["R"] // 3, letters["S"], seen)

    @property
    def sets(self) -> dict[str, Layout]:
        """The layout of each set of attributes, or image, by what the attributes' names begin
        with."""
        direct = {DIRECT: self.packing.direct} if self.direct else {}
        return {PREFIX: self.packing, **direct}

    @property
    def in_atlas(self) -> bool:
        """Whether the bake is in a texture."""
        return self.carrier == "texture"

    @property
    def beyond_transfer(self) -> bool:
        """Whether it stores more than the transfer, which belongs to one light."""
        return self.packing.turns > 0 or self.packing.lights > 0


def blank(
    obj: bpy.types.Object, layout: Layout, domain: str, by_modifier: bool, mesh_signature: str
) -> Stamp:
    """The stamp of a bake on vertices of ``obj`` as it stands, its figures still empty."""
    matrix = obj.matrix_world
    return Stamp(
        order=layout.order,
        channels=layout.channels,
        layout=layout.slots,
        carrier="vertex",
        domain=domain,
        by_modifier=by_modifier,
        job_hash="",
        mesh_signature=mesh_signature,
        matrix=tuple(value for column in matrix.to_3x3().transposed() for value in column),
        location=tuple(matrix.translation),
        points=0,
        rays=0,
        mrays_per_second=0.0,
    )


def read(obj: bpy.types.Object) -> Stamp | None:
    """The stamp of ``obj``; None where it was never baked, or by a version that we don't know."""
    text = obj.get(KEY)
    return _parse(text) if isinstance(text, str) else None


@lru_cache(maxsize=1024)
def _parse(text: str) -> Stamp | None:
    """Kept, because handlers and panels ask at every change and every redraw."""
    values = json.loads(text)
    if values.get("version") not in READABLE:
        return None
    values["version"] = VERSION
    for name in ("layout", "matrix", "location"):
        values[name] = tuple(values[name])
    return Stamp(**values)


def write(obj: bpy.types.Object, stamp: Stamp) -> None:
    """Stamp ``obj``, whose share of the residual stays as it is, and switch its bake on."""
    obj[KEY] = json.dumps(asdict(stamp))
    switch(obj, on=True)


def switch(obj: bpy.types.Object, on: bool) -> None:
    """Show the bake, or the artist's shader; touches nothing that is already so."""
    value = 1.0 if on else 0.0
    if obj.get(SWITCH) != value:
        obj[SWITCH] = value
        obj.update_tag()


def share(obj: bpy.types.Object) -> float:
    """How much of its residual ``obj`` shows under the scene's baked light."""
    return float(obj.get(EXACT, 0.0))


def set_share(obj: bpy.types.Object, value: float) -> None:
    """Let it be ``value``; touches nothing that is already so."""
    if share(obj) != value or EXACT not in obj:
        obj[EXACT] = float(value)
        obj.update_tag()


def image_of(obj: bpy.types.Object) -> bpy.types.Image | None:
    """The atlas that ``obj`` shows; None where its bake is on vertices, or the image is gone."""
    return obj.get(ATLAS)


def set_image(obj: bpy.types.Object, image: bpy.types.Image | None) -> None:
    """Let ``obj`` show ``image``, or none."""
    if image is not None:
        obj[ATLAS] = image
    elif ATLAS in obj:
        del obj[ATLAS]


def remove(obj: bpy.types.Object) -> None:
    """Take stamp and switches away."""
    for key in MARKS:
        if key in obj:
            del obj[key]
    obj.update_tag()


def baked_objects(scene: bpy.types.Scene) -> list[bpy.types.Object]:
    """The objects of ``scene`` that carry a bake."""
    return [obj for obj in scene.objects if KEY in obj]
