"""The light that a scene's bakes show: ``scene["prt_light"]`` (JSON).

The image's coefficients are kept without rotation and strength, so a turned or recoloured world
needs neither the image nor the engine.
"""

import json
from dataclasses import dataclass
from typing import Any

import bpy
import numpy as np
import numpy.typing as npt

KEY = "prt_light"
Coefficients = npt.NDArray[np.float64]


@dataclass(frozen=True)
class LightState:
    """``image_sh`` (25, 3): the image alone (1 where the world is a colour); ``image_key`` names
    its content; ``radiance_sh`` (25, 3): the world's light as it is now, world frame, Z up;
    ``baked_radiance_sh`` (25, 3): the same when it was baked; ``follows`` is False where the world
    is a node tree that had to be rendered, so that only *Update Light* can follow it."""

    image_key: str
    image_sh: Coefficients
    radiance_sh: Coefficients
    baked_radiance_sh: Coefficients
    follows: bool = True


def read(scene: bpy.types.Scene) -> LightState | None:
    """The light of ``scene``; None where nothing was baked."""
    text = scene.get(KEY)
    if not isinstance(text, str):
        return None
    values: dict[str, Any] = json.loads(text)
    for name in ("image_sh", "radiance_sh", "baked_radiance_sh"):
        values[name] = np.array(values[name])
    return LightState(**values)


def write(scene: bpy.types.Scene, state: LightState) -> None:
    """Keep ``state`` in the .blend."""
    values = {
        name: value.tolist() if isinstance(value, np.ndarray) else value
        for name, value in vars(state).items()
    }
    scene[KEY] = json.dumps(values)


def remove(scene: bpy.types.Scene) -> None:
    """Forget the light, with the last bake."""
    if KEY in scene:
        del scene[KEY]
