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
    id, as primitives may share them.  The names of its attributes begin with ``prefix``."""

    layout: Layout
    values: Mapping[int, Floats]
    prefix: str = PREFIX

    @property
    def names(self) -> list[str]:
        """Of the floats in use."""
        return [name for name in self.layout.slots if name]

    def used(self) -> Floats:
        """The floats in use of all elements, (E, F), one set after the other."""
        places = [k for k, name in enumerate(self.layout.slots) if name]
        return np.concatenate(list(self.values.values()))[:, places]


@dataclass(frozen=True)
class Written:
    """What becomes of the attributes ``names``: what is ``stored`` (E, 4 k) of each set, by its id,
    float32 or int16; and what the extras say of it."""

    names: Sequence[str]
    stored: Mapping[int, npt.NDArray[Any]]
    says: dict[str, Any]


def read(  # noqa: PLR0917 - one caller
    primitives: Iterable[Any],
    packing: Layout,
    shown: Layout,
    share: float,
    frame: Any,
    prefix: str,
) -> Vertices | None:
    """What ``primitives`` hold of ``packing`` in attributes whose names begin with ``prefix``,
    turned, as ``shown`` with a ``share`` of the residuals; None where attributes are gone."""
    values: dict[int, Floats] = {}
    for primitive in primitives:
        stored = gltf_attributes.read(primitive.attributes, packing.called(prefix))
        if stored is not None:
            key = id(primitive.attributes)
            values[key] = gltf_frame.turned(stored, packing, shown, share, frame)
        elif primitive.mode in TRIANGLES:
            return None
    return Vertices(shown, values, prefix)


def plain(vertices: Vertices, short: bool) -> Written:
    """The floats of ``vertices``, as 16-bit numbers where ``short`` says so."""
    scale = gltf_attributes.scale_of(vertices.values.values()) if short else None
    quantize = gltf_attributes.quantized
    stored = {
        key: values if scale is None else quantize(values, scale)
        for key, values in vertices.values.items()
    }
    says = {
        "layout": list(vertices.layout.slots),
        "scale": 1 if scale is None else scale.tolist(),
    }
    return Written(vertices.layout.called(vertices.prefix), stored, says)


def coded(vertices: Vertices, codes: Codes, error: float) -> Written:
    """The same in clusters, which leave a relative RMS ``error``."""
    numbers = np.concatenate([codes.clusters[:, None], np.rint(LARGEST * codes.weights)], axis=1)
    ends = np.cumsum([len(values) for values in vertices.values.values()])[:-1]
    parts = np.split(numbers.astype(np.int16), ends)
    count = codes.weights.shape[1]
    names = [f"{vertices.prefix}{k}" for k in range((1 + count) // 4)]
    rows = np.concatenate([codes.means[:, None], codes.directions], axis=1)
    book = [float(f"{value:.{DIGITS}g}") for value in rows.ravel().tolist()]
    says = {
        "layout": vertices.names,
        "scale": 1,
        "clusters": {
            "layout": ["K", *(f"W{j}" for j in range(count))],
            "error": error,
            "values": book,
        },
    }
    return Written(names, dict(zip(vertices.values, parts, strict=True)), says)


def write(primitives: Iterable[Any], written: Sequence[Written]) -> None:
    """Give ``primitives`` what is ``written``, and no other attributes of ours."""
    replaced: dict[int, gltf_attributes.Accessors] = {}
    for primitive in primitives:
        before = primitive.attributes
        if id(before) not in replaced:
            replaced[id(before)] = gltf_attributes.bare(before)
            for one in written:
                if id(before) in one.stored:
                    its = gltf_attributes.holding(before, one.names, one.stored[id(before)])
                    replaced[id(before)] |= its
        primitive.attributes = replaced[id(before)]


def codes_of(
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
