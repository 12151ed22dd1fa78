"""What Blender's glTF exporter calls while it writes: it puts every bake into the file.

The schema is in docs/gltf.md.  Called for each scene in this order:
``vtree_before_filter_hook``, for each object ``gather_node_mesh_hook``, ``gather_attribute_keep``,
``gather_mesh_hook`` and ``gather_node_hook``, then ``gather_scene_hook``, when all nodes are known;
at the end once ``gather_gltf_hook``.  (``pre_export_hook`` is newer than Blender 4.3.)
"""

from collections.abc import Iterable
from copy import copy
from dataclasses import replace
from typing import Any

import bpy
import numpy as np

from . import (
    atlas_images,
    default_surface,
    gltf_attributes,
    gltf_colors,
    gltf_frame,
    gltf_ibl,
    gltf_panel,
    gltf_textures,
    gltf_vertices,
    light_state,
    stale,
    stamp,
)
from .gltf_attributes import BASIS, BOUNCES, INCLUDES, VERSION
from .prt import sh
from .prt.job import Peak
from .prt.layout import DIRECT, Layout

UNMOVED = 1e-5  # of the largest entry of a world matrix

Settings = dict[str, Any]
Kept = tuple[bpy.types.Object, str]  # and what the names of the attributes begin with

REPORT: list[dict[str, Any]] = []  # of the last export: what compressing each bake has cost


def shown_bakes() -> dict[bpy.types.Object, stamp.Stamp]:
    """The objects of this file whose bake is shown: baked, and not stale."""
    stamps = {obj: stamp.read(obj) for obj in bpy.data.objects if obj.get(stamp.SWITCH) == 1.0}
    return {o: found for o, found in stamps.items() if found and stale.same_image(o, found)}


class glTF2ExportUserExtension:  # the exporter looks for this name
    """One export.  Does nothing in a file without bakes."""

    is_critical = True  # a file with half a bake in it is worse than none

    def __init__(self) -> None:
        # Now, because the exporter may go to another frame
        self._bakes = shown_bakes()
        self._shares = {obj: stamp.share(obj) for obj in self._bakes}
        self._lights = {scene.name: light_state.read(scene) for scene in bpy.data.scenes}
        self._stamped = any(stamp.KEY in obj for obj in bpy.data.objects)
        self._short = gltf_panel.wants_short(bpy.context.scene)
        self._error = gltf_panel.wanted_error(bpy.context.scene)
        self._ibl = gltf_ibl.Lights() if gltf_panel.wants_ibl(bpy.context.scene) else None
        self._vertices: dict[Kept, gltf_vertices.Vertices | None] = {}
        self._codes: dict[Kept, tuple[Any, float]] = {}  # and their error
        REPORT.clear()
        self._artist: Settings = {}
        self._meshes: dict[tuple[int, str, bool], Any] = {}
        self._maps: dict[int, gltf_textures.UvMap] = {}  # by id of the exporter's mesh
        self._atlases: gltf_textures.Atlases | None = None
        self._originals: list[Any] = []

    def vtree_before_filter_hook(self, _tree: Any, settings: Settings) -> None:
        """Let our attributes out; called once a scene."""
        if self._artist:
            return
        self._artist = {name: settings[name] for name in ("gltf_attributes", "gltf_apply")}
        if self._stamped:
            settings["gltf_attributes"] = True
        if settings.get("gltf_draco_mesh_compression") and self._bakes:
            self._bakes = {}
            _warn(settings, "Draco would round the bakes, so they were left out: switch it off")
        textured = [obj for obj, found in self._bakes.items() if found.in_atlas]
        if textured and not settings["gltf_texcoords"]:
            self._bakes = {o: found for o, found in self._bakes.items() if not found.in_atlas}
            names = ", ".join(sorted(obj.name for obj in textured))
            _warn(settings, f"Left out the bake of {names}: textures need UVs, switch them on")

    def gather_node_mesh_hook(
        self, _node_mesh: Any, obj: bpy.types.Object | None, settings: Settings
    ) -> None:
        """The baked mesh is the evaluated one; other objects stay as the artist wants them."""
        settings["gltf_apply"] = self._artist["gltf_apply"] or obj in self._bakes

    def gather_attribute_keep(self, attribute: Any, _settings: Settings) -> None:
        """Of the artist's attributes only those that he asked for."""
        if not self._artist["gltf_attributes"] and not gltf_attributes.is_ours(attribute.attr_name):
            attribute.keep = False

    def gather_mesh_hook(
        self,
        mesh: Any,
        data: Any,
        _obj: Any,
        _groups: Any,
        _modifiers: Any,
        materials: tuple[bpy.types.Material | None, ...],
        settings: Settings,
    ) -> None:
        """COLOR_n and materials are the artist's alone."""
        if not self._stamped or not isinstance(data, bpy.types.Mesh):
            return
        mesh.extras = _without_ours(mesh.extras)
        colors = gltf_colors.of(data, materials, settings)
        defaults = {m.name for m in materials if m and default_surface.is_ours(m)}
        for primitive in mesh.primitives:
            primitive.attributes = colors.of_the_artist(primitive.attributes)
            if primitive.material is not None and primitive.material.name in defaults:
                primitive.material = None
        uv_map = gltf_textures.uv_map(data) if settings["gltf_texcoords"] else None
        if uv_map is not None:
            self._originals.append(mesh)  # so that its id stays its own
            self._maps[id(mesh)] = uv_map

    def gather_node_hook(self, node: Any, _obj: bpy.types.Object | None, _settings: Any) -> None:
        """Stamps are for the .blend."""
        node.extras = _without_ours(node.extras)

    def gather_material_hook(self, material: Any, *_others: Any) -> None:
        """What we remember of the artist's material is for the .blend."""
        material.extras = _without_ours(material.extras)

    def gather_scene_hook(
        self, scene: Any, blender_scene: bpy.types.Scene, settings: Settings
    ) -> None:
        """Give baked nodes their transfer and all others a mesh without."""
        settings["gltf_apply"] = self._artist["gltf_apply"]
        frame = gltf_frame.of(settings)
        nodes = [n for n in settings["vtree"].nodes.values() if n.node and n.node.mesh]
        matrices = self._matrices(nodes, gltf_frame.world_matrices(scene.nodes), frame)
        light = self._lights.get(blender_scene.name)
        self._read_vertices(nodes, matrices, light, frame)
        left_out = {n.blender_object for n in nodes if not self._dress(n, matrices, frame)}
        told = settings.get("gltf_draco_mesh_compression") or not settings["gltf_texcoords"]
        if left_out and not told:
            names = ", ".join(sorted(obj.name for obj in left_out))
            _warn(settings, f"Left out the bake of {names}: it is out of date, bake again")
        scene.extras = _without_ours(scene.extras)
        if self._ibl is not None:
            self._add_ibl(self._ibl, scene, blender_scene.name, settings)
        if light is not None and matrices:
            scene.extras = {**(scene.extras or {}), "prt_light": _light(light, frame)}

    def _add_ibl(self, lights: gltf_ibl.Lights, scene: Any, name: str, settings: Settings) -> None:
        lights.dress(scene, name, gltf_frame.of(settings))
        if name in lights.problems:
            problem = lights.problems[name]
            _warn(settings, f"Left out the image-based light of {name}: {problem}")

    def gather_gltf_hook(
        self, _active: Any, _scenes: Any, animations: list[Any], _settings: Settings
    ) -> None:
        """A baked mesh whose modifiers made new vertices has no shape keys left to animate."""
        for animation in animations:
            animation.channels = [c for c in animation.channels if not _aims_at_nothing(c.target)]
        animations[:] = [animation for animation in animations if animation.channels]

    def _matrices(
        self, nodes: Iterable[Any], worlds: dict[int, Any], frame: Any
    ) -> dict[bpy.types.Object, Any]:
        """The world 3x3 when baked of every baked object: its node's own, as the file has it, where
        that still stands as it was baked."""
        matrices: dict[bpy.types.Object, Any] = {}
        for node in nodes:
            obj = node.blender_object
            if obj not in self._bakes:
                continue
            baked = gltf_frame.turn_matrix(self._bakes[obj].matrix, frame)
            now = frame @ np.array(node.matrix_world.to_3x3(), np.float64) @ frame.T
            if np.abs(now - baked).max() <= UNMOVED * np.abs(baked).max():
                matrices[obj] = worlds[id(node.node)]
            matrices.setdefault(obj, baked)
        return matrices

    def _dress(self, node: Any, matrices: dict[bpy.types.Object, Any], frame: Any) -> bool:
        """Exchange the mesh of ``node``; False where an object was baked and comes out without."""
        obj, mesh = node.blender_object, node.node.mesh
        uv_map = self._maps.get(id(mesh))
        stray = uv_map is not None and (uv_map.ours or _has_our_map(obj))
        key = (id(mesh), obj.name_full if obj in matrices else "", stray)
        if key not in self._meshes:
            self._originals.append(mesh)  # so that its id stays its own
            dressed = self._baked(mesh, obj, matrices[obj], frame) if key[1] else None
            self._meshes[key] = dressed or _bare(mesh, uv_map if stray else None)
        node.node.mesh = self._meshes[key]
        return obj is None or stamp.KEY not in obj or _is_baked(node.node.mesh)

    def _baked(self, mesh: Any, obj: bpy.types.Object, matrix: Any, frame: Any) -> Any | None:
        """``mesh`` with the bake of ``obj`` in glTF's frame; None where its attributes or its image
        are gone."""
        twin, mark = _twin(mesh), self._bakes[obj]
        shown = _shown(mark.packing, self._shares[obj])
        if mark.in_atlas:
            stored = self._in_texture(twin, self._maps.get(id(mesh)), obj, frame)
        else:
            stored = self._on_vertices(twin, obj)
        if stored is None:
            return None
        description = _description(shown, matrix, bool(mark.bounces), stored)
        twin.extras = {**(mesh.extras or {}), "prt": description}
        return twin

    def _in_texture(
        self, twin: Any, uv_map: gltf_textures.UvMap | None, obj: bpy.types.Object, frame: Any
    ) -> dict[str, Any] | None:
        """What the extras of ``twin`` say of the atlas of ``obj``; None where it is gone, or where
        a primitive cannot read it."""
        image, mark = stamp.image_of(obj), self._bakes[obj]
        surfaces = [p.attributes for p in twin.primitives if p.mode in gltf_vertices.TRIANGLES]
        if image is None or 0 in image.size or not image.has_data:
            return None
        if uv_map is None or not all(uv_map.name in attributes for attributes in surfaces):
            return None
        binary = type(surfaces[0]["POSITION"].buffer_view)
        self._atlases = self._atlases or gltf_textures.Atlases(frame)
        for primitive in twin.primitives:
            primitive.attributes = gltf_attributes.bare(primitive.attributes)
        share, found = self._shares[obj], []
        for its, packing in zip(atlas_images.both(image), mark.sets.values(), strict=False):
            if stale.of_its_bake(its) and 0 not in its.size and its.has_data:
                pictures = self._atlases.of(its, packing, binary)
                texture = {"images": pictures.images, "texCoord": uv_map.index}
                found.append(pictures.shown(_shown(packing, share), share) | {"texture": texture})
        return _with_direct(*found)

    def _on_vertices(self, twin: Any, obj: bpy.types.Object) -> dict[str, Any] | None:
        """Give ``twin`` the attributes of ``obj``, turned: what its extras say of them; None where
        they are gone."""
        both = [self._vertices.get((obj, prefix)) for prefix in self._bakes[obj].sets]
        if both[0] is None:
            return None
        written = [self._written(obj, one) for one in both if one is not None]
        gltf_vertices.write(twin.primitives, written)
        return _with_direct(*(one.says for one in written))

    def _written(
        self, obj: bpy.types.Object, vertices: gltf_vertices.Vertices
    ) -> gltf_vertices.Written:
        codes, error = self._codes.get((obj, vertices.prefix), (None, 0.0))
        if codes is not None:
            return gltf_vertices.coded(vertices, codes, error)
        return gltf_vertices.plain(vertices, self._short or self._error > 0)

    def _read_vertices(
        self, nodes: list[Any], matrices: Iterable[Any], light: Any, frame: Any
    ) -> None:
        """The bakes on vertices of ``nodes``, and their codes where such are wanted."""
        for node in nodes:
            obj, primitives = node.blender_object, node.node.mesh.primitives
            if obj not in matrices or self._bakes[obj].in_atlas:
                continue
            share = self._shares[obj]
            for prefix, packing in self._bakes[obj].sets.items():
                shown = _shown(packing, share)
                read = gltf_vertices.read(primitives, packing, shown, share, frame, prefix)
                self._vertices[obj, prefix] = read
        found = {key: read for key, read in self._vertices.items() if read is not None}
        if not self._error:
            return
        answers = gltf_vertices.codes_of(list(found.values()), light, frame, self._error)
        for (obj, prefix), (codes, report) in zip(found, answers, strict=True):
            if codes is not None:
                self._codes[obj, prefix] = codes, report["chosen"]["error"]
            REPORT.append({"name": obj.name, "direct": prefix == DIRECT, **report})


def _shown(packing: Layout, share: float) -> Layout:
    """The layout of the file: without what belongs to another light than the file's."""
    return packing if share else replace(packing, turns=0, lights=0)


def _with_direct(whole: dict[str, Any], direct: dict[str, Any] | None = None) -> dict[str, Any]:
    """What the extras say of the ``whole``, and of what is kept without bounces."""
    return whole if direct is None else whole | {"direct": direct}


def _has_our_map(obj: bpy.types.Object | None) -> bool:
    """Whether the map *PRT* of ``obj`` came with a bake."""
    mark = stamp.read(obj) if obj is not None else None
    return mark is not None and mark.in_atlas and not mark.own_uvs


def _bare(mesh: Any, uv_map: gltf_textures.UvMap | None) -> Any:
    """``mesh`` without transfer, and without ``uv_map``."""
    if uv_map is None and not any(map(gltf_attributes.is_ours, _attribute_names(mesh))):
        return mesh
    twin = _twin(mesh)
    for primitive in twin.primitives:
        primitive.attributes = gltf_attributes.bare(primitive.attributes)
        if uv_map is not None:
            primitive.attributes = uv_map.without(primitive.attributes)
    return twin


def _twin(mesh: Any) -> Any:
    """A mesh of its own, with primitives of its own."""
    twin = copy(mesh)
    twin.primitives = [copy(primitive) for primitive in mesh.primitives]
    return twin


def _aims_at_nothing(target: Any) -> bool:
    """Does an animation move shape keys that a baked mesh does not have?"""
    mesh = target.node.mesh if target.path == "weights" else None
    return _is_baked(mesh) and not any(primitive.targets for primitive in mesh.primitives)


def _is_baked(mesh: Any | None) -> bool:
    return mesh is not None and "prt" in (mesh.extras or {})


def _attribute_names(mesh: Any) -> set[str]:
    return {name for primitive in mesh.primitives for name in primitive.attributes}


def _description(
    layout: Layout, matrix: Any, bounces: bool, stored: dict[str, Any]
) -> dict[str, Any]:
    """``mesh.extras.prt``; ``stored`` says how the floats lie in attributes or in pictures."""
    return {
        "version": VERSION,
        "order": layout.order,
        "channels": layout.channels,
        **({"turns": layout.turns} if layout.turns > 1 else {}),
        "frame": "world",
        "matrix": matrix.ravel(order="F").tolist(),
        "basis": BASIS,
        "includes": INCLUDES + BOUNCES * bounces,
        **stored,
    }


def _light(light: light_state.LightState, frame: Any) -> dict[str, Any]:
    """``scene.extras.prt_light``."""
    return {
        "order": sh.order_of(len(light.radiance_sh)),
        "radiance_sh": sh.rotate(light.radiance_sh, frame).tolist(),
        "baked_radiance_sh": sh.rotate(light.baked_radiance_sh, frame).tolist(),
        "lights": [_peak(peak, frame) for peak in light.peaks],
    }


def _peak(peak: Peak, frame: Any) -> dict[str, Any]:
    """One of ``prt_light.lights``."""
    return {
        "direction": (frame @ np.array(peak.direction)).tolist(),
        "irradiance": list(peak.irradiance),
        "angular_radius": peak.angular_radius,
    }


def _without_ours(extras: dict[str, Any] | None) -> dict[str, Any] | None:
    """Custom properties of the artist's."""
    kept = {key: v for key, v in (extras or {}).items() if key != "prt" and key[:4] != "prt_"}
    return kept or None


def _warn(settings: Settings, sentence: str) -> None:
    settings["log"].warning(f"PRT Baker: {sentence}", popup=True)
