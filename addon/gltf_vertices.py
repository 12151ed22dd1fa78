"""Bakes on vertices in the exporter's primitives: as floats, as 16-bit numbers, or in clusters."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from . import engine, gltf_attributes, gltf_frame
from .gltf_attributes import LARGEST
from .light_state import LightState
from .prt import sh
from .prt.compression import importance
from .prt.compression.choosing import Part
from .prt.compression.pca import Codes
from .prt.compression.request import Request
from .prt.layout import PREFIX, Layout
from .prt.light import residual

TRIANGLES = (None, 4)  # loose edges and points have no corners
DIGITS = 6  # of a number in JSON, relative to itself: finer than 16 bits are
WHITE = np.eye(25)[:, :1] * np.ones(3)  # a light, where the scene has none

Floats = npt.NDArray[np.float32]


@dataclass(frozen=True)
class Vertices:
    """A bake of ``layout`` in glTF's frame: ``values`` (E, 4 k) for each set of attributes, by its
    id, as primitives may share them."""

    layout: Layout
    values: Mapping[int, Floats]

    @property
    def names(self) -> list[str]:
        """Of the floats in use."""
        return [name for name in self.layout.slots if name]

    def used(self) -> Floats:
        """The floats in use of all elements, (E, F), one set after the other."""
        places = [k for k, name in enumerate(self.layout.slots) if name]
        return np.concatenate(list(self.values.values()))[:, places]


def read(
    primitives: Iterable[Any], packing: Layout, shown: Layout, share: float, frame: Any
) -> Vertices | None:
    """What ``primitives`` hold of ``packing``, turned, as ``shown`` with a ``share`` of the
    residuals; None where attributes are gone."""
    values: dict[int, Floats] = {}
    for primitive in primitives:
        stored = gltf_attributes.read(primitive.attributes, packing.attributes)
        if stored is not None:
            key = id(primitive.attributes)
            values[key] = gltf_frame.turned(stored, packing, shown, share, frame)
        elif primitive.mode in TRIANGLES:
            return None
    return Vertices(shown, values)


def write(primitives: Iterable[Any], vertices: Vertices, short: bool) -> dict[str, Any]:
    """Give ``primitives`` the floats of ``vertices``, as 16-bit numbers where ``short`` says so;
    what the extras say of them."""
    scale = gltf_attributes.scale_of(vertices.values.values()) if short else None
    quantize = gltf_attributes.quantized
    stored = {
        key: values if scale is None else quantize(values, scale)
        for key, values in vertices.values.items()
    }
    _replace(primitives, vertices.layout.attributes, stored)
    slots = list(vertices.layout.slots)
    return {"layout": slots, "scale": 1 if scale is None else scale.tolist()}


def write_coded(
    primitives: Iterable[Any], vertices: Vertices, codes: Codes, error: float
) -> dict[str, Any]:
    """The same in clusters, which leave a relative RMS ``error``."""
    numbers = np.concatenate([codes.clusters[:, None], np.rint(LARGEST * codes.weights)], axis=1)
    ends = np.cumsum([len(values) for values in vertices.values.values()])[:-1]
    parts = np.split(numbers.astype(np.int16), ends)
    count = codes.weights.shape[1]
    names = [f"{PREFIX}{k}" for k in range((1 + count) // 4)]
    _replace(primitives, names, dict(zip(vertices.values, parts, strict=True)))
    rows = np.concatenate([codes.means[:, None], codes.directions], axis=1)
    book = [float(f"{value:.{DIGITS}g}") for value in rows.ravel().tolist()]
    return {
        "layout": vertices.names,
        "scale": 1,
        "clusters": {
            "layout": ["K", *(f"W{j}" for j in range(count))],
            "error": error,
            "values": book,
        },
    }


def _replace(
    primitives: Iterable[Any], names: Sequence[str], stored: Mapping[int, npt.NDArray[Any]]
) -> None:
    """Let the attributes ``names`` be what is ``stored`` (E, 4 k) of each set, and no others of
    ours."""
    replaced: dict[int, gltf_attributes.Accessors] = {}
    for primitive in primitives:
        before = primitive.attributes
        if id(before) not in stored:
            primitive.attributes = gltf_attributes.bare(before)
            continue
        if id(before) not in replaced:
            replaced[id(before)] = gltf_attributes.replaced(before, names, stored[id(before)])
        primitive.attributes = replaced[id(before)]


def coded(
    bakes: Sequence[Vertices], light: LightState | None, frame: gltf_frame.Float, tolerance: float
) -> list[tuple[Codes | None, dict[str, Any]]]:
    """Codes of ``bakes`` whose relative error of the light is at most ``tolerance``, None where
    they save nothing, and what the engine reports of each."""
    parts = [_part(vertices, light, frame) for vertices in bakes]
    return engine.compressed(Request(parts, tolerance)) if parts else []


def _part(vertices: Vertices, light: LightState | None, frame: gltf_frame.Float) -> Part:
    baked, peaks = (light.baked_radiance_sh, light.peaks) if light is not None else (WHITE, ())
    baked = sh.rotate(baked, frame)
    shown = peaks[: vertices.layout.lights]
    cut_out = sh.rotate(residual.peaks_sh(shown), frame)
    lights = np.array([peak.irradiance for peak in shown]).reshape(-1, 3) / np.pi
    matters = importance.importance_of(vertices.names, baked, lights)
    radiance = importance.radiance_of(vertices.names, baked, cut_out, lights)
    return Part(vertices.used(), matters, radiance)
