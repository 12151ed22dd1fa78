"""Which colours a bounced bake took in: ``scene["prt_albedo"]`` (JSON), by the hash of its job and
by object.

Light that bounced off a red wall is red for ever; when the wall is painted blue, all that was baked
together with it is stale.  What is looked at are materials and colour attributes, not pixels: those
of a picture may change, and Blender tells nobody.
"""

import hashlib
import json
from collections.abc import Iterable
from dataclasses import astuple

import bpy
import numpy as np

from . import albedo_plan, material_attributes, scene_albedo, stamp, tree_digest
from .albedo_plan import Color, Plan
from .prt.digests import add_array

KEY = "prt_albedo"
STEPS = 1000  # of a colour: closer ones are one
DIGITS = 12
Digests = dict[str, str]


def of(objects: Iterable[bpy.types.Object]) -> Digests:
    """A digest of what each object reflects, by its name."""
    known: dict[bpy.types.Material | None, tuple[bytes, tuple[str, ...]]] = {}
    return {obj.name: _of_object(obj, known) for obj in objects}


def keep(scene: bpy.types.Scene, job_hash: str, digests: Digests) -> None:
    """Keep what the bake of this job took in, and forget those that no object shows any more."""
    everything = {**_kept(scene), **({job_hash: digests} if digests else {})}
    marks = map(stamp.read, stamp.baked_objects(scene))
    shown = {mark.job_hash for mark in marks if mark is not None}
    left = {job: its for job, its in everything.items() if job in shown}
    if left:
        scene[KEY] = json.dumps(left)
    elif KEY in scene:
        del scene[KEY]


def forget(scene: bpy.types.Scene) -> None:
    """Forget what no object shows any more."""
    if KEY in scene:
        keep(scene, "", {})


def recoloured(scene: bpy.types.Scene, job_hash: str) -> str | None:
    """The name of an object whose colours are others than those that the job's bake took in; None
    where all are the same.  Objects that are gone are not looked for."""
    before = _kept(scene).get(job_hash, {})
    found = (bpy.data.objects[name] for name in before if name in bpy.data.objects)
    now = of(obj for obj in found if obj.type != "EMPTY")
    return next((name for name, digest in now.items() if digest != before[name]), None)


def _kept(scene: bpy.types.Scene) -> dict[str, Digests]:
    text = scene.get(KEY)
    return json.loads(text) if isinstance(text, str) else {}


def _of_object(
    obj: bpy.types.Object,
    known: dict[bpy.types.Material | None, tuple[bytes, tuple[str, ...]]],
) -> str:
    digest = hashlib.blake2b(digest_size=DIGITS // 2)
    for material in [slot.material for slot in obj.material_slots] or [None]:
        if material not in known:
            known[material] = _of_material(material)
        look, layers = known[material]
        digest.update(look)
        if obj.type == "MESH":
            for layer in layers:
                colors = np.nan_to_num(scene_albedo.colors_at_corners(obj.data, layer)).clip(0, 1)
                add_array(digest, layer, np.rint(colors * STEPS).astype(np.int32))
    return digest.hexdigest()


def _of_material(material: bpy.types.Material | None) -> tuple[bytes, tuple[str, ...]]:
    """What names its colours, and the colour attributes that they are."""
    plan = albedo_plan.read(material)
    if plan.colors is None and material is not None:
        return tree_digest.of_nodes(material_attributes.nodes_of(material)), ()
    named = [_named(weight, color) for weight, color in plan.colors or ()]
    return repr(named).encode(), tuple(_layers(plan))


def _named(weight: float, color: Color) -> tuple[object, ...]:
    """A colour as it is compared: rounded, so that what is not seen makes no other."""
    value, *rest = astuple(color)
    picture = bpy.data.images.get(color.image)
    file = (picture.filepath, picture.colorspace_settings.name) if picture is not None else ()
    steps = np.nan_to_num(weight * STEPS * np.array(value)).clip(0, STEPS)
    return tuple(np.rint(steps).astype(int).tolist()), rest, file


def _layers(plan: Plan) -> Iterable[str]:
    return (color.layer for _, color in plan.colors or () if color.kind == "attribute")
