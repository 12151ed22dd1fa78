"""A bake that no longer fits its object is switched off, and on again when it fits.

An object is compared with the stamp of its bake: its place in the world and its own mesh, not its
modifiers, shape keys or pose; and its image with the bake that it says it is of, for a file may be
gone, or be another bake's, after an undo or where two .blend files write to one.  Where light
bounced, the colours that it bounced off are compared too.
"""

import bpy
import numpy as np
from bpy.app.handlers import persistent

from . import albedo_state, atlas_files, atlas_images
from . import scene as scene_arrays
from . import stamp as stamps
from .stamp import Stamp

COLOURS = ("MATERIAL", "NODETREE", "IMAGE", "MESH")  # what may be another colour
TOLERANCE = 1e-5  # of the matrix, and of a metre; parents and constraints jitter by float32


def reason(obj: bpy.types.Object, stamp: Stamp) -> str | None:
    """Why the bake of ``obj`` is not shown, one sentence; None where it is.  Looks at no vertex."""
    if _moved(obj, stamp):
        return f"{obj.name} has been moved, turned or scaled since its bake: bake it again"
    if not same_image(obj, stamp):
        return f"The image of {obj.name} is gone or another bake's: bake it again"
    if other := _recoloured(obj, stamp):
        return f"{other} has other colours than those that bounced off it: bake again"
    if not obj.get(stamps.SWITCH):
        return f"The mesh of {obj.name} has been edited since its bake: bake it again"
    return None


def refresh(scene: bpy.types.Scene) -> None:
    """Switch every bake of ``scene`` on or off, by what its object is now."""
    for obj in stamps.baked_objects(scene):
        _refresh(obj)


def _refresh(obj: bpy.types.Object, recoloured: dict[str, str | None] | None = None) -> None:
    """``recoloured``: what is known already of the colours that each job's bake took in."""
    stamp = stamps.read(obj)
    if stamp is None or obj.data.is_editmode:
        return
    fits = not _moved(obj, stamp) and same_image(obj, stamp) and _same_mesh(obj, stamp)
    others = recoloured if recoloured is not None else {}
    if fits and stamp.job_hash not in others:
        others[stamp.job_hash] = _recoloured(obj, stamp)
    stamps.switch(obj, on=fits and others[stamp.job_hash] is None)


def _recoloured(obj: bpy.types.Object, stamp: Stamp) -> str | None:
    """An object whose colours are others than when light bounced off it to ``obj``."""
    if not stamp.bounces:
        return None
    found = (albedo_state.recoloured(scene, stamp.job_hash) for scene in obj.users_scene)
    return next((name for name in found if name), None)


def _moved(obj: bpy.types.Object, stamp: Stamp) -> bool:
    matrix = np.array(obj.matrix_world)
    turn, baked_turn = matrix[:3, :3].T.ravel(), np.array(stamp.matrix)
    place, baked_place = matrix[:3, 3], np.array(stamp.location)
    turned = np.abs(turn - baked_turn).max() > TOLERANCE * np.abs(baked_turn).max()
    return bool(turned or np.abs(place - baked_place).max() > TOLERANCE * _reach(baked_place))


def _reach(place: np.ndarray) -> float:
    return float(max(1.0, np.abs(place).max()))


def same_image(obj: bpy.types.Object, stamp: Stamp) -> bool:
    """Whether the atlas that ``obj`` shows is there and of its bake."""
    if not stamp.in_atlas:
        return True
    image = stamps.image_of(obj)
    return image is not None and of_its_bake(image)


def of_its_bake(image: bpy.types.Image) -> bool:
    """Whether ``image`` is an atlas, and its file that of its bake."""
    atlas, path = atlas_images.of(image), atlas_files.path_of(image)
    return atlas is not None and (path is None or atlas_files.job_hash(path) == atlas.job_hash)


def _same_mesh(obj: bpy.types.Object, stamp: Stamp) -> bool:
    return scene_arrays.mesh_signature(obj) == stamp.mesh_signature


@persistent
def _on_update(scene: bpy.types.Scene, depsgraph: bpy.types.Depsgraph) -> None:
    if albedo_state.KEY in scene and _may_be_recoloured(depsgraph):
        _refresh_bounced(scene)
    if not depsgraph.id_type_updated("OBJECT"):
        return
    for update in depsgraph.updates:
        if not (update.is_updated_transform or update.is_updated_geometry):
            continue
        obj = update.id.original
        if isinstance(obj, bpy.types.Object) and stamps.KEY in obj:
            _refresh(obj)


def _may_be_recoloured(depsgraph: bpy.types.Depsgraph) -> bool:
    """Not where things only moved."""
    if any(map(depsgraph.id_type_updated, COLOURS)):
        return True
    return any(u.is_updated_geometry or u.is_updated_shading for u in depsgraph.updates)


def _refresh_bounced(scene: bpy.types.Scene) -> None:
    """Look at the colours that light bounced off, once for all that was baked together."""
    recoloured: dict[str, str | None] = {}
    for obj in stamps.baked_objects(scene):
        stamp = stamps.read(obj)
        if stamp is not None and stamp.bounces:
            if stamp.job_hash not in recoloured:
                recoloured[stamp.job_hash] = _recoloured(obj, stamp)
            if bool(obj.get(stamps.SWITCH)) == bool(recoloured[stamp.job_hash]):
                _refresh(obj, recoloured)


@persistent
def _on_change(*_: object) -> None:
    """Files change behind Blender's back: look when one is opened, and after undo and redo."""
    for scene in bpy.data.scenes:
        marked = ((obj, stamps.read(obj)) for obj in stamps.baked_objects(scene))
        textured = [obj for obj, stamp in marked if stamp is not None and stamp.in_atlas]
        if textured:
            scene.view_layers[0].update()  # matrices are not there yet
        for obj in textured:
            _refresh(obj)


def register() -> None:
    """Watch the baked objects."""
    handlers = bpy.app.handlers
    handlers.depsgraph_update_post.append(_on_update)
    for changes in (handlers.load_post, handlers.undo_post, handlers.redo_post):
        changes.append(_on_change)


def unregister() -> None:
    """Watch them no more."""
    handlers = bpy.app.handlers
    for changes in (handlers.redo_post, handlers.undo_post, handlers.load_post):
        changes.remove(_on_change)
    handlers.depsgraph_update_post.remove(_on_update)
