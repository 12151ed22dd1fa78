"""The light that a scene's bakes show: ``scene["prt_light"]`` (JSON).

The image's coefficients are kept without rotation and strength, so a turned or recoloured world
needs neither the image nor the engine.
"""

import json
from dataclasses import asdict, dataclass
from typing import Any

import bpy
import numpy as np
import numpy.typing as npt

from .prt.job import IDENTITY, Peak, Vector
from .prt.layout import Layout
from .prt.light import residual
from .prt.light.residual import Terms

KEY = "prt_light"
SAME = 1e-6  # of a light: two readings of one world differ by rounding
Coefficients = npt.NDArray[np.float64]


@dataclass(frozen=True)
class LightState:
    """``image_sh`` (25, 3): the image alone (1 where the world is a colour); ``image_key`` names
    its content; ``radiance_sh`` (25, 3): the world's light as it is now, world frame, Z up;
    ``baked_radiance_sh`` (25, 3): the same when it was baked; ``follows`` is False where the world
    is a node tree that had to be rendered, so that only *Update Light* can follow it; ``peaks``
    are the suns and lamps cut out of the baked light, which has them still.  ``rotation`` takes
    world directions to the image's, and ``strength`` is what it is multiplied by, as they are now:
    reflections, which read the image itself, need them."""

    image_key: str
    image_sh: Coefficients
    radiance_sh: Coefficients
    baked_radiance_sh: Coefficients
    follows: bool = True
    peaks: tuple[Peak, ...] = ()
    rotation: tuple[Vector, Vector, Vector] = IDENTITY
    strength: Vector = (1.0, 1.0, 1.0)

    @property
    def shadow_share(self) -> float:
        """How much of the shadows of the peaks is still where it was baked, 0 to 1."""
        return residual.likeness(self.radiance_sh, self.baked_radiance_sh)


def read(scene: bpy.types.Scene) -> LightState | None:
    """The light of ``scene``; None where nothing was baked."""
    text = scene.get(KEY)
    if not isinstance(text, str):
        return None
    values: dict[str, Any] = json.loads(text)
    for name in ("image_sh", "radiance_sh", "baked_radiance_sh"):
        values[name] = np.array(values[name])
    values["peaks"] = tuple(map(Peak.of, values.get("peaks", ())))
    values["rotation"] = tuple(map(tuple, values.get("rotation", IDENTITY)))
    values["strength"] = tuple(values.get("strength", (1.0, 1.0, 1.0)))
    return LightState(**values)


def write(scene: bpy.types.Scene, state: LightState) -> None:
    """Keep ``state`` in the .blend."""
    values = {
        name: value.tolist() if isinstance(value, np.ndarray) else value
        for name, value in vars(state).items()
    }
    values["peaks"] = [asdict(peak) for peak in state.peaks]
    scene[KEY] = json.dumps(values)


def remove(scene: bpy.types.Scene) -> None:
    """Forget the light, with the last bake."""
    if KEY in scene:
        del scene[KEY]


def terms(state: LightState, layout: Layout) -> Terms:
    """What a bake of ``layout`` is multiplied by, besides its transfer."""
    peaks = state.peaks[: layout.lights]
    return residual.terms(state.radiance_sh, state.baked_radiance_sh, layout.turns, peaks)


def is_baked(state: LightState) -> bool:
    """Whether the light is what it was when it was baked."""
    departed = np.linalg.norm(state.radiance_sh - state.baked_radiance_sh)
    return bool(departed <= SAME * np.linalg.norm(state.baked_radiance_sh))


def share(baked: LightState, other: LightState, with_peaks: bool) -> float:
    """How much of a residual of ``baked`` belongs to ``other``, whose baked light is taken as the
    reference instead: the ratio of the two where they differ in strength alone, else 0.

    ``with_peaks``: the residual lacks the light of the peaks, so they have to be the same.
    """
    strength = np.linalg.norm(other.baked_radiance_sh)
    before = np.linalg.norm(baked.baked_radiance_sh)
    if not strength or not before:
        return 0.0
    ratio = strength / before
    rest = other.baked_radiance_sh - ratio * baked.baked_radiance_sh
    if np.linalg.norm(rest) > SAME * strength:
        return 0.0
    if with_peaks and not _same_peaks(baked.peaks, other.peaks, ratio):
        return 0.0
    return float(ratio)


def _same_peaks(first: tuple[Peak, ...], second: tuple[Peak, ...], ratio: float) -> bool:
    """Whether the peaks ``second`` are ``first``, ``ratio`` times as strong."""
    if len(first) != len(second):
        return False
    return all(
        np.allclose(a.direction, b.direction, atol=SAME)
        and np.allclose(ratio * np.array(a.irradiance), b.irradiance, rtol=SAME)
        and np.isclose(a.angular_radius, b.angular_radius, atol=SAME)
        for a, b in zip(first, second, strict=True)
    )
