"""What Blender's glTF importer calls while it reads: bakes of the file become bakes of the scene.

Called in this order: ``gather_import_scene_before_hook``, for each mesh
``gather_import_mesh_before_hook`` and ``gather_import_mesh_after_hook``, and when all objects are
there ``gather_import_scene_after_nodes_hook``.  Whatever is wrong with a bake, the mesh comes in
with its plain material and a sentence says why.
"""

from collections.abc import Iterable
from copy import copy
from dataclasses import replace
from typing import Any

import bpy
import numpy as np
from io_scene_gltf2.io.imp.gltf2_io_binary import BinaryData
from mathutils import Matrix

from . import (
    atlas_images,
    attributes,
    carrier,
    gltf_frame,
    gltf_pictures,
    light_state,
    live_light,
    scene,
    stamp,
    writeback,
)
from .gltf_attributes import FLOAT, LARGEST, SHORT, is_ours
from .gltf_extras import FileBake, read_bake, read_light
from .light_state import LightState
from .prt import layout as layouts
from .prt.errors import BakeError
from .prt.job import ALL
from .prt.layout import Layout
from .prt.results import ReceiverResult

DRACO = "KHR_draco_mesh_compression"
TURNED = 1e-4  # of a matrix: what is more is another place than the bake's
RIGID = 1e-3

Baked = tuple[bpy.types.Object, ReceiverResult, stamp.Stamp]


class glTF2ImportUserExtension:  # the importer looks for this name
    """One import.  Does nothing for a file without bakes."""

    def __init__(self) -> None:
        self._light: Any = None
        self._merge = False  # what the artist chose
        self._bakes: dict[int, FileBake] = {}  # by id of the importer's mesh
        self._values: dict[str, tuple[FileBake, Any]] = {}  # by name of Blender's mesh
        self._pictures: gltf_pictures.Pictures | None = None

    def gather_import_scene_before_hook(self, gltf_scene: Any, _scene: Any, _gltf: Any) -> None:
        """Keep our light from being written over that of the scene."""
        self._light = (gltf_scene.extras or {}).pop("prt_light", None)

    def gather_import_mesh_before_hook(self, mesh: Any, gltf: Any) -> None:
        """Check what the file says; the importer reads no 16-bit numbers, so give it floats."""
        prt = (mesh.extras or {}).pop("prt", None)
        if prt is None:
            return
        try:
            bake = read_bake(prt)
            for its in bake.both:
                for primitive in mesh.primitives:
                    _check_primitive(primitive, its, gltf)
                if its.images:
                    self._pictures = self._pictures or gltf_pictures.Pictures(gltf)
                    self._pictures.check(its)
            for primitive in mesh.primitives:
                for name in filter(is_ours, primitive.attributes):
                    _as_floats(gltf, gltf.data.accessors[primitive.attributes[name]])
            self._bakes[id(mesh)] = bake
            # Merged vertices would keep one side's values of an edge
            self._merge = gltf.import_settings["merge_vertices"]
            gltf.import_settings["merge_vertices"] = False
        except BakeError as error:
            for primitive in mesh.primitives:
                for name in list(filter(is_ours, primitive.attributes)):
                    del primitive.attributes[name]
            _warn(gltf, f"{mesh.name} comes without its bake: {error}")

    def gather_import_mesh_after_hook(self, gltf_mesh: Any, mesh: Any, gltf: Any) -> None:
        """Take the values off the mesh; they go back with all that belongs to a bake.  Those of a
        bake in pictures are its UVs, whose map the materials may still be about to name."""
        bake = self._bakes.get(id(gltf_mesh))
        if bake is None:
            return
        gltf.import_settings["merge_vertices"] = self._merge
        if bake.images:
            name = (
                mesh.uv_layers[bake.tex_coord].name if bake.tex_coord < len(mesh.uv_layers) else ""
            )
            self._values[mesh.name] = bake, name
            return
        stored = attributes.take(mesh)
        attributes.remove(mesh)
        try:
            values = [_floats(its, stored) for its in bake.both]
        except BakeError as error:
            _warn(gltf, f"{mesh.name} comes without its bake: {error}")
            return
        self._values[mesh.name] = bake, values

    def gather_import_scene_after_nodes_hook(
        self, _gltf_scene: Any, blender_scene: bpy.types.Scene, gltf: Any
    ) -> None:
        """Bake every object that shows one of those meshes, and light it."""
        objects = [o for o in blender_scene.objects if o.data and o.data.name in self._values]
        objects = [obj for obj in objects if obj.type == "MESH"]
        if not objects:
            return
        try:
            light = read_light(self._light)
            shares = self._bake(blender_scene, objects, light, gltf)
            _take_light(blender_scene, light, shares)
        except BakeError as error:
            _warn(gltf, f"The file comes without its bakes: {error}")

    def _bake(
        self,
        owner: bpy.types.Scene,
        objects: list[bpy.types.Object],
        light: LightState,
        gltf: Any,
    ) -> dict[bpy.types.Object, bool]:
        """Write the bakes of ``objects``; whether each stands as it was baked."""
        depsgraph = carrier.depsgraph_of(owner)
        shares: dict[bpy.types.Object, bool] = {}
        groups: dict[Any, list[Baked]] = {}
        atlases: dict[Any, gltf_pictures.FileAtlas] = {}
        uvs = self._take_uvs(objects)
        for obj in objects:
            bake, values = self._values[obj.data.name]
            turn = _turn_since(bake, obj.matrix_world)
            if turn is None:
                _warn(gltf, f"{obj.name} comes without its bake: it was deformed since")
                continue
            shares[obj] = turn is UNTURNED
            layout = _shown(bake.layout, len(light.peaks), shares[obj])
            by_modifier = carrier.needs_modifier(obj, depsgraph)
            made = stamp.blank(obj, layout, "POINT", by_modifier, scene.mesh_signature(obj))
            made = replace(
                made,
                points=len(obj.data.vertices),
                bounces=ALL if bake.bounces else 0,
                direct=bake.direct is not None,
            )
            if bake.images:
                atlas = gltf_pictures.FileAtlas(bake, layout, turn)
                made = replace(made, carrier="texture", domain="CORNER")
                made = replace(made, atlas_size=self._pictures.size(bake))
                atlases[atlas.key] = atlas
                result = gltf_pictures.result(obj.name, layout, uvs[obj.data.name])
            else:
                atlas = None
                result = _result(obj, bake, values, layout, turn)
            key = (layout.order, layout.channels, atlas and atlas.key)
            groups.setdefault(key, []).append((obj, result, made))
        for (_, _, key), group in groups.items():
            images = [self._pictures.atlas(atlases[key])] if key else []
            for obj in _left_out(owner, group, images, gltf):
                del shares[obj]
        atlas_images.free_unused()
        return shares

    def _take_uvs(self, objects: list[bpy.types.Object]) -> dict[str, Any]:
        """The UVs (C, 2) of the meshes whose bakes are in pictures, by name, which lose them."""
        meshes = {obj.data.name: obj.data for obj in objects}
        return {
            name: gltf_pictures.take_uvs(meshes[name], layer)
            for name, (bake, layer) in self._values.items()
            if bake.images and name in meshes
        }


def _left_out(
    owner: bpy.types.Scene, group: list[Baked], images: list[bpy.types.Image], gltf: Any
) -> list[bpy.types.Object]:
    """Write bakes that one material may show, all or none; the objects that could not be."""
    layout = layouts.covering(result for _, result, _ in group)
    try:
        baked = [(obj, result, _with(mark, layout)) for obj, result, mark in group]
        writeback.write(owner, baked, layout, images)
    except BakeError as error:
        for obj, _, _ in group:
            _warn(gltf, f"{obj.name} comes without its bake: {error}")
        return [obj for obj, _, _ in group]
    return []


UNTURNED = np.eye(3)


def _check_primitive(primitive: Any, bake: FileBake, gltf: Any) -> None:
    """BakeError where a triangle primitive lacks what ``bake`` needs."""
    if primitive.mode not in {None, 4, 5, 6}:
        return
    if DRACO in (primitive.extensions or {}):
        raise BakeError("Draco has rounded it")
    if bake.images:
        gltf_pictures.check_uvs(primitive, bake, gltf)
    else:
        _check_attributes(primitive, bake.attributes, gltf)


def _check_attributes(primitive: Any, names: Iterable[str], gltf: Any) -> None:
    """BakeError where a triangle primitive lacks one of the attributes ``names``."""
    vertices = gltf.data.accessors[primitive.attributes["POSITION"]].count
    for name in names:
        if name not in primitive.attributes:
            raise BakeError(f"attribute {name} is missing")
        accessor = gltf.data.accessors[primitive.attributes[name]]
        short = accessor.component_type == SHORT and accessor.normalized
        if accessor.type != "VEC4" or not (short or accessor.component_type == FLOAT):
            raise BakeError(f"attribute {name} is neither VEC4 of floats nor of normalized SHORT")
        if accessor.count != vertices:
            raise BakeError(f"attribute {name} has {accessor.count} values for {vertices} vertices")
        if not np.isfinite(BinaryData.decode_accessor_obj(gltf, accessor)).all():
            raise BakeError(f"attribute {name} has a value that is no number")


def _floats(bake: FileBake, stored: attributes.Stored) -> Any:
    """What ``stored`` attributes hold of ``bake``, (vertices, 4 k)."""
    columns = [stored[name][1] for name in bake.attributes]
    return bake.arranged(bake.decoded(np.concatenate(columns, axis=1)))


def _as_floats(gltf: Any, accessor: Any) -> None:
    """Let ``accessor`` of normalized SHORT be one of the same floats, in a buffer of their own."""
    if accessor.component_type == FLOAT:
        return
    stored = BinaryData.decode_accessor_obj(gltf, accessor)
    if stored.dtype == np.int16:
        stored = np.maximum(stored / np.float32(LARGEST), -1)
    data = np.ascontiguousarray(stored, np.float32).tobytes()
    view = copy(gltf.data.buffer_views[accessor.buffer_view])
    view.buffer = max(gltf.buffers, default=0) + len(gltf.data.buffers)
    view.byte_offset, view.byte_length, view.byte_stride = 0, len(data), None
    gltf.buffers[view.buffer] = memoryview(data)
    gltf.data.buffer_views.append(view)
    accessor.buffer_view, accessor.byte_offset = len(gltf.data.buffer_views) - 1, 0
    accessor.component_type, accessor.normalized, accessor.sparse = FLOAT, False, None


def _turn_since(bake: FileBake, world: Matrix) -> Any | None:
    """The rotation (3, 3) of an object since its bake, ``UNTURNED`` where it stands as it did; None
    where it is none."""
    now = np.array(world.to_3x3(), np.float64)
    if np.abs(now - bake.matrix).max() <= TURNED * np.abs(bake.matrix).max():
        return UNTURNED
    if not abs(np.linalg.det(bake.matrix)):
        return None
    turn = now @ np.linalg.inv(bake.matrix)
    return turn if np.abs(turn @ turn.T - np.eye(3)).max() <= RIGID else None


def _shown(layout: Layout, lights: int, standing: bool) -> Layout:
    """What of ``layout`` is kept: residual and visibilities belong to the light as it fell on the
    object when it was baked, and visibilities to lights that the scene has."""
    if not standing:
        return replace(layout, turns=0, lights=0)
    return replace(layout, lights=min(layout.lights, lights))


def _result(
    obj: bpy.types.Object, bake: FileBake, values: Any, layout: Layout, turn: Any
) -> ReceiverResult:
    """``values``, (vertices, 4 k) of the whole and of what has no bounces, Y up, as a bake of
    ``obj``, Z up."""
    frame = turn @ gltf_frame.Y_UP.T
    results = []
    for its, shown, floats in zip(bake.both, (layout, layout.direct), values, strict=False):
        turned = gltf_frame.turned(floats, its.layout, shown, 1.0, frame)
        found = vars(layouts.unpack(shown, turned))
        elements = np.arange(len(floats), dtype=np.int32)
        results.append(ReceiverResult(obj.name, element_points=elements, **found))
    return results[0].with_direct(results[1]) if bake.direct is not None else results[0]


def _with(mark: stamp.Stamp, layout: Layout) -> stamp.Stamp:
    values = vars(mark) | {"layout": layout.slots, "order": layout.order}
    return stamp.Stamp(**values)


def _take_light(
    owner: bpy.types.Scene, light: LightState, shares: dict[bpy.types.Object, bool]
) -> None:
    """Light the bakes: by the light of the scene where it has one, which those of the file then
    follow as far as theirs is the same."""
    before = light_state.read(owner)
    for obj, standing in shares.items():
        mark = stamp.read(obj)
        if not standing or mark is None:
            stamp.set_share(obj, 0.0)
        elif before is not None:
            with_peaks = mark.packing.lights > 0
            stamp.set_share(obj, light_state.share(light, before, with_peaks))
    live_light.show(owner, before or light)


def _warn(gltf: Any, sentence: str) -> None:
    gltf.log.warning(f"PRT Baker: {sentence}", popup=True)
