"""The diffuse reflectance of meshes at the corners of their triangles: what light bounces off."""

from dataclasses import dataclass

import bpy
import numpy as np

from . import albedo_bake, albedo_plan, scene_meshes
from .albedo_plan import Color, Plan
from .prt.job import Array

MISSING = (1.0, 0.0, 1.0)  # Cycles shows a picture that can't be read like this
SAMPLES = 16  # of a picture, over each triangle
LARGEST = 1024  # pixels a side that are looked at
CHUNK = 1 << 16  # triangles
PLASTIC = 1.32471795724474602596


@dataclass
class Read:
    """Albedo (F, 3, 3) float32, linear, 0 to 1, at the ``corners`` (F, 3) of a mesh's triangles.
    Of the triangles ``unknown`` (U,) it is still to be baked."""

    albedo: Array
    corners: Array
    unknown: Array

    def __getitem__(self, kept: Array) -> "Read":
        """Of the triangles ``kept`` (F,) bool alone."""
        unknown = np.zeros(len(kept), bool)
        unknown[self.unknown] = True
        return Read(self.albedo[kept], self.corners[kept], np.flatnonzero(unknown[kept]))

    def bake(self, obj: bpy.types.Object, depsgraph: bpy.types.Depsgraph) -> None:
        """Let Cycles find what is not known of the evaluated ``obj``.  Nothing of the depsgraph may
        be gone through meanwhile."""
        if len(self.unknown):
            colors = albedo_bake.bake(obj, depsgraph)
            self.albedo[self.unknown] = colors[self.corners[self.unknown]].clip(0, 1)


class Albedos:
    """Reads the albedo of objects, each material and picture once; ``emitters`` are the names of
    the objects that shine by themselves, which no bake knows."""

    def __init__(self) -> None:
        self._plans: dict[bpy.types.Material | None, Plan] = {}
        self._pictures: dict[str, Array | None] = {}
        self.emitters: list[str] = []

    def of(self, obj: bpy.types.Object, mesh: bpy.types.Mesh, triangles: Array) -> Read:
        """What the evaluated ``mesh`` of the evaluated ``obj`` reflects at the corners
        ``triangles`` (F, 3)."""
        materials = [slot.material for slot in obj.material_slots] or [None]
        of_triangles = _material_of_triangles(mesh, triangles, len(materials))
        whole = np.zeros((len(triangles), 3, 3), np.float32)
        unknown = [np.zeros(0, np.int64)]
        for k in np.unique(of_triangles):
            mine, plan = np.flatnonzero(of_triangles == k), self._plan(materials[k])
            if plan.emits and obj.name not in self.emitters:
                self.emitters.append(obj.name)
            if plan.colors is None:
                unknown.append(mine)
            for weight, color in plan.colors or ():
                whole[mine] += weight * self._read(color, mesh, triangles[mine])
        return Read(np.clip(np.nan_to_num(whole), 0, 1), triangles, np.concatenate(unknown))

    def _plan(self, material: bpy.types.Material | None) -> Plan:
        if material not in self._plans:
            self._plans[material] = albedo_plan.read(material)
        return self._plans[material]

    def _read(self, color: Color, mesh: bpy.types.Mesh, triangles: Array) -> Array:
        """``color`` at corners ``triangles`` (F, 3): (F, 3, 3), or one that stands for all."""
        if color.kind == "attribute":
            return colors_at_corners(mesh, color.layer)[triangles]
        if color.kind == "image":
            return self._picture(color, mesh, triangles)
        return np.float32(color.value)[None, None]

    def _picture(self, color: Color, mesh: bpy.types.Mesh, triangles: Array) -> Array:
        """The mean of a picture about each corner of the triangles, so that a wall reflects what
        all of it does, however fine its pattern."""
        if color.image not in self._pictures:
            self._pictures[color.image] = _pixels(bpy.data.images[color.image])
        pixels, uvs = self._pictures[color.image], _uvs(mesh, color.layer)
        if pixels is None or uvs is None:
            found = MISSING if pixels is None else pixels[0, 0]
            return np.float32(found)[None, None]
        shares = _shares()
        out = np.empty((len(triangles), 3, 3), np.float32)
        for start in range(0, len(triangles), CHUNK):
            corners = uvs[triangles[start : start + CHUNK]]
            values = _sampled(pixels, np.einsum("sk,fkc->fsc", shares, corners), color.extends)
            out[start : start + CHUNK] = np.einsum("sk,fsc->fkc", shares, values)
        return out / shares.sum(axis=0)[:, None]


def _shares() -> Array:
    """Places spread over a triangle: barycentric coordinates (SAMPLES, 3)."""
    u, v = ((0.5 + np.arange(SAMPLES) * PLASTIC**-power) % 1 for power in (1, 2))
    outside = u + v > 1
    u, v = np.where(outside, 1 - u, u), np.where(outside, 1 - v, v)
    return np.stack([1 - u - v, u, v], axis=1).astype(np.float32)


def _sampled(pixels: Array, uvs: Array, extends: bool) -> Array:
    """The nearest pixels (..., 3) of a picture (H, W, 3), bottom row first, at ``uvs`` (..., 2)."""
    height, width = pixels.shape[:2]
    place = uvs.clip(0, 1 - 1e-7) if extends else uvs % 1
    columns = (place[..., 0] * width).astype(np.int64).clip(0, width - 1)
    rows = (place[..., 1] * height).astype(np.int64).clip(0, height - 1)
    return pixels[rows, columns]


def _material_of_triangles(mesh: bpy.types.Mesh, triangles: Array, count: int) -> Array:
    """The slot (F,) of each of ``triangles`` (F, 3), which are corners."""
    of_polygons = scene_meshes.attribute(mesh, "material_index")
    if not len(of_polygons) or count == 1:
        return np.zeros(len(triangles), np.int64)
    starts = np.empty(len(mesh.polygons), np.int32)
    mesh.polygons.foreach_get("loop_start", starts)
    polygons = np.searchsorted(starts, triangles[:, 0], side="right") - 1
    return of_polygons[polygons].clip(0, count - 1)


def colors_at_corners(mesh: bpy.types.Mesh, name: str) -> Array:
    """A colour attribute (C, 3) at every corner; black where there is none."""
    name = name or mesh.color_attributes.default_color_name
    found = mesh.attributes.get(name)
    if found is None or found.data_type not in {"FLOAT_COLOR", "BYTE_COLOR"}:
        return np.zeros((len(mesh.loops), 3), np.float32)
    values = np.empty(len(found.data) * 4, np.float32)
    found.data.foreach_get("color", values)
    colors = values.reshape(-1, 4)[:, :3]
    return colors[scene_meshes.corner_vertices(mesh)] if found.domain == "POINT" else colors


def _uvs(mesh: bpy.types.Mesh, name: str) -> Array | None:
    """A UV map (C, 2) at every corner; None where there is none."""
    rendered = (layer for layer in mesh.uv_layers if layer.active_render)
    layer = mesh.uv_layers.get(name) if name else next(rendered, None)
    if layer is None:
        return None
    values = np.empty(len(layer.uv) * 2, np.float32)
    layer.uv.foreach_get("vector", values)
    return values.reshape(-1, 2)


def _pixels(image: bpy.types.Image) -> Array | None:
    """The linear colours (H, W, 3) of a picture, bottom row first and not larger than it takes;
    None where it can't be read."""
    image.pixels[:1]  # loads it
    if not image.has_data or not all(image.size):
        return None
    small, copied = image, max(image.size) > LARGEST
    if copied:
        small = image.copy()
        small.scale(*(max(1, round(side * LARGEST / max(image.size))) for side in image.size))
    try:
        width, height = small.size
        values = np.empty(width * height * small.channels, np.float32)
        small.pixels.foreach_get(values)
    finally:
        if copied:
            bpy.data.images.remove(small)
    rows = values.reshape(height, width, -1)
    colors = rows[..., :3] if rows.shape[2] >= 3 else rows[..., :1].repeat(3, axis=-1)
    encoded = image.colorspace_settings.name == "sRGB" and not image.is_float
    return _linear(colors) if encoded else colors


def _linear(encoded: Array) -> Array:
    """What ``encoded`` sRGB values are in linear light."""
    low = encoded / 12.92
    high = ((np.maximum(encoded, 0) + 0.055) / 1.055) ** 2.4
    return np.where(encoded <= 0.04045, low, high).astype(np.float32)
