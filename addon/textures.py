"""Between a scene and its atlases: which UV maps objects bring along, images, what they show."""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

import bpy
import numpy as np
import numpy.typing as npt

from . import atlas_files, atlas_images, carrier, scene, sharing, stamp, uv_maps
from .atlas_files import Target
from .prt import job as jobs
from .prt import layout as layouts
from .prt.errors import BakeError
from .prt.results import Atlas, Results
from .prt.surface.points import Surface
from .prt.surface.samples import random_places
from .prt.texture.sampling import bilinear

NAME = "PRT Atlas"
Floats = npt.NDArray[np.float32]


def receivers(
    objects: Sequence[bpy.types.Object], read: Sequence[jobs.Receiver], target: Target
) -> tuple[jobs.Receiver, ...]:
    """``read`` with what decides how they lie in atlases."""
    if target.carrier == "vertex":
        return tuple(read)
    depsgraph = bpy.context.evaluated_depsgraph_get()
    groups = sharing.groups(list(objects), depsgraph)
    found = []
    for obj, receiver, group in zip(objects, read, groups, strict=True):
        uvs, key = _uvs(obj, depsgraph)
        its = replace(receiver, carrier=target.carrier, group=group, uvs=uvs, uv_key=key)
        found.append(its)
    return tuple(found)


def _uvs(obj: bpy.types.Object, depsgraph: bpy.types.Depsgraph) -> tuple[Floats | None, str]:
    """The map PRT of ``obj``, and its key where it is ours; None where it has none that is worth
    keeping."""
    with carrier.evaluated_mesh(obj, depsgraph) as mesh:
        uvs, corners = uv_maps.read(mesh), len(mesh.loops)
    holder, mark = carrier.of(obj), stamp.read(obj)
    by_us = holder is not None and uv_maps.is_ours(holder.data)
    if uvs is None:
        return None, ""
    if not by_us and not uv_maps.is_ours(obj.data):
        return uvs, ""
    as_baked = mark is not None and mark.in_atlas and not mark.own_uvs
    as_baked = as_baked and scene.mesh_signature(obj) == mark.mesh_signature
    as_baked = as_baked and (not by_us or len(holder.data.loops) == corners)
    return (uvs, mark.uv_key) if as_baked and mark.uv_key else (None, "")


@contextmanager
def images(results: Results, target: Target) -> Iterator[list[bpy.types.Image]]:
    """The atlases of ``results`` as images, in files or packed, with those that were kept without
    bounces; on an error inside there are neither."""
    members: list[list[str]] = [[] for _ in results.atlases]
    for result in results.receivers:
        if result.in_atlas is not None:
            members[result.in_atlas.atlas].append(result.name)
    with_direct = [k for k, atlas in enumerate(results.atlases) if atlas.direct is not None]
    atlases = [*results.atlases, *(results.atlases[k].direct for k in with_direct)]
    sources = [atlas.path for atlas in atlases]
    if target.folder is None:
        with _loaded(atlases, sources, results.report["job_hash"]) as found:
            for image, source in zip(found, sources, strict=True):
                image.pack()
                image.filepath_raw = f"//{target.stem} {source.name}"
            yield _wholes(found, with_direct)
        return
    paths = atlas_files.paths(target, members)
    paths += [atlas_files.direct_path(paths[k]) for k in with_direct]
    files = [file for atlas in atlases for file in atlas.files]
    for_engines = [
        place
        for path, atlas in zip(paths, atlases, strict=True)
        for place in atlas_files.beside(path, atlas.path, atlas.files)
    ]
    with (
        atlas_files.placed([*sources, *files], [*paths, *for_engines]),
        _loaded(atlases, paths, results.report["job_hash"]) as found,
    ):
        for image, path in zip(found, paths, strict=True):
            image.filepath_raw = _relative(path)
        yield _wholes(found, with_direct)


def _wholes(images: list[bpy.types.Image], with_direct: list[int]) -> list[bpy.types.Image]:
    """``images`` without the last ones, which are those without bounces of some of the others."""
    wholes = images[: len(images) - len(with_direct)]
    for k, direct in zip(with_direct, images[len(wholes) :], strict=True):
        atlas_images.set_direct(wholes[k], direct)
    return wholes


@contextmanager
def _loaded(
    atlases: Sequence[Atlas], paths: Sequence[Path], job_hash: str
) -> Iterator[list[bpy.types.Image]]:
    """Images of the files ``paths``, gone on an error inside; called alike once the images of an
    earlier bake are gone."""
    found: list[bpy.types.Image] = []
    try:
        for atlas, path in zip(atlases, paths, strict=True):
            what = atlas_images.Atlas(atlas.size, atlas.margin, job_hash)
            found.append(atlas_images.load(path, NAME, what))
        yield found
    except BaseException:
        for image in set(found) & set(bpy.data.images):
            bpy.data.images.remove(image)
        raise
    for image in found:
        if NAME not in bpy.data.images:
            image.name = NAME


def _relative(path: Path) -> str:
    """As Blender keeps it: relative to the .blend, where that is possible."""
    if not bpy.data.filepath:
        return str(path.absolute())
    try:
        return bpy.path.relpath(str(path.absolute()))
    except ValueError:  # on another drive
        return str(path.absolute())


def with_what_is_shown(
    receiver: jobs.Receiver, obj: bpy.types.Object, mark: stamp.Stamp, count: int, seed: int
) -> tuple[jobs.Receiver, layouts.Values]:
    """``receiver`` with ``count`` random places, and what the atlas of ``obj`` shows there."""
    image = stamp.image_of(obj)
    with carrier.evaluated_mesh(obj, bpy.context.evaluated_depsgraph_get()) as mesh:
        uvs = uv_maps.read(mesh)
    if image is None or uvs is None or not image.has_data or 0 in image.size:
        raise BakeError(f"The image or the UV map of {obj.name!r} is gone: bake it again")
    places = random_places(Surface.of(receiver).areas, count, seed)
    corners = uvs[receiver.triangle_corners[places.triangles]]
    at = np.einsum("pk,pkc->pc", places.barycentric, corners.astype(np.float64))
    values = layouts.unpack(mark.packing, sampled(image, mark.packing, at))
    rows = np.concatenate([places.triangles[:, None], places.barycentric], axis=1)
    return replace(receiver, places=rows, uvs=None, uv_key=""), values


def sampled(image: bpy.types.Image, layout: layouts.Layout, uvs: npt.NDArray[np.float64]) -> Floats:
    """What ``image`` shows at ``uvs`` (S, 2), as ``layouts.pack`` arranges it (S, 4 k)."""
    margin = atlas_images.margin(image)
    values = atlas_images.columns(image, len(layout.attributes))
    return bilinear(values, np.clip(uvs, margin, 1 - margin))
