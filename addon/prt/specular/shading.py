"""What *PRT Shading* makes of a Principled BSDF's reflections, in numpy.

    F0, F90 = of the dielectric  2 level tint ((ior - 1) / (ior + 1))²,  min(1, 50 max F0)
              of the metal       base colour,  1
    S       = (F0 A + F90 B) (1 + F0 (1 / (A + B) - 1))         the last factor: energy compensation
    exit    = base colour (1 - metallic) (1 - max S_dielectric) diffuse
              + mix(S_dielectric, S_metal, metallic) L

A and B at (roughness, n_v), L the filtered radiance about mix(mirrored, normal, s) of roughness
q r, r being the roughness and s and q of ``look_up`` at (r, n_v).
"""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from . import look_up as look_up_table

Float = npt.NDArray[np.float64]
EDGE = 50.0  # F90 is 1 from F0 = 0.02 on, and fades with it below


@dataclass(frozen=True)
class Surface:
    """A Principled BSDF: ``base`` (3,) and the rest as its sockets are called."""

    base: tuple[float, float, float] = (0.8, 0.8, 0.8)
    metallic: float = 0.0
    roughness: float = 0.5
    ior: float = 1.5
    level: float = 0.5
    tint: tuple[float, float, float] = (1.0, 1.0, 1.0)


def dielectric(surface: Surface) -> tuple[Float, float]:
    """F0 (3,) and F90 of what is not metal."""
    f0 = 2 * surface.level * ((surface.ior - 1) / (surface.ior + 1)) ** 2 * np.array(surface.tint)
    f0 = np.minimum(f0, 1)
    return f0, float(min(1.0, EDGE * f0.max()))


def reflectance(f0: Float, f90: float, split: Float, *, compensated: bool = True) -> Float:
    """``S`` (P, 3) for ``split`` (P, 2), A and B."""
    a, b = split[:, :1], split[:, 1:]
    plain = f0 * a + f90 * b
    return np.asarray(plain * (1 + f0 * (1 / (a + b) - 1)) if compensated else plain)


def parts(surface: Surface, split: Float, *, compensated: bool = True) -> tuple[Float, Float]:
    """What the diffuse exit radiance of a white surface, and the filtered radiance, are multiplied
    by (P, 3) each."""
    f0, f90 = dielectric(surface)
    coated = reflectance(f0, f90, split, compensated=compensated)
    metal = reflectance(np.array(surface.base), 1.0, split, compensated=compensated)
    below = (1 - surface.metallic) * (1 - coated.max(axis=1, keepdims=True))
    specular = coated + surface.metallic * (metal - coated)
    return below * np.array(surface.base), specular


def look_up(
    normals: Float, views: Float, roughness: npt.ArrayLike, *, bent: bool = True
) -> tuple[Float, Float]:
    """Where radiance is read (P, 3), and of which roughness (P,), for unit ``normals`` and
    ``views`` (P, 3), towards the viewer."""
    facing = (normals * views).sum(axis=1, keepdims=True)
    mirrored = 2 * facing * normals - views
    rough = np.array(np.broadcast_to(np.asarray(roughness, np.float64), len(normals)))
    if bent:
        share, ratio = look_up_table.at(rough, facing[:, 0].clip(0, 1))
        mirrored = mirrored + share[:, None] * (normals - mirrored)
        rough = np.minimum(rough * ratio, look_up_table.ROUGHEST)
    return np.asarray(mirrored / np.linalg.norm(mirrored, axis=1, keepdims=True)), rough
