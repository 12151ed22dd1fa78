"""What surfaces reflect of a picture, summed over every texel of it: no split sum, no filter."""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from prt_baker.addon.prt.light import lat_long
from prt_baker.addon.prt.specular import brdf, shading, sheet
from prt_baker.addon.prt.specular.shading import Surface

Array = npt.NDArray[np.float32]
Float = npt.NDArray[np.float64]


class Sky:
    """A lat-long picture (H, W, 3), top row first, as the flux of its texels."""

    def __init__(self, pixels: Array) -> None:
        height, width = pixels.shape[:2]
        angles = lat_long.row_solid_angles(height, width)[:, None, None]
        self._flux = np.ascontiguousarray((pixels * angles).reshape(-1, 3).T, np.float32)
        self._towards = np.ascontiguousarray(
            lat_long.directions(height, width).reshape(-1, 3).T, np.float32
        )

    def sums(self, normals: Float, view: Float, roughness: float) -> "Sums":
        """Of surfaces with ``normals`` (P, 3) seen from unit ``view`` (3,), in the picture's
        frame."""
        halves = self._towards + np.float32(view)[:, None]
        halves /= np.maximum(np.linalg.norm(halves, axis=0), np.float32(1e-6))
        edge = np.float32((1 - np.clip(np.float32(view) @ halves, 0, 1)) ** 5)
        found = np.empty((len(normals), 3, 3))
        for out, normal in zip(found, np.float32(normals), strict=True):
            n_l, n_h = normal @ self._towards, normal @ halves
            above = np.flatnonzero(n_l > 0)
            n_l = n_l[above].astype(np.float64)
            part = brdf.distribution(roughness**2, n_h[above]) * n_l / 4
            k = brdf.environment_k(roughness)
            part *= brdf.visible_part(k, n_l) * brdf.visible_part(k, float(normal @ view))
            flux = self._flux[:, above]
            out[:] = flux @ part, flux @ (part * edge[above]), flux @ n_l / np.pi
        return Sums(*found.transpose(1, 0, 2))


@dataclass(frozen=True)
class Sums:
    """At P places: the radiance reflected by ``all`` of a surface whose Fresnel factor is 1, the
    part of it that is of ``edge``, ``Fc``, and what leaves a ``white`` diffuse surface (P, 3)."""

    all: Float
    edge: Float
    white: Float

    def exit_radiance(self, surface: Surface, split: Float, *, compensated: bool = True) -> Float:
        """Of ``surface`` (P, 3): what ``shading`` says, but for the one step that it takes for
        granted, that A and B can be taken out of the sum.  They are ``split`` (P, 2)."""
        f0, f90 = shading.dielectric(surface)
        diffuse, _ = shading.parts(surface, split, compensated=compensated)
        coat = self._reflected(f0, f90, split, compensated)
        metal = self._reflected(np.array(surface.base), 1.0, split, compensated)
        return diffuse * self.white + coat + surface.metallic * (metal - coat)

    def _reflected(self, f0: Float, f90: float, split: Float, compensated: bool) -> Float:
        plain = f0 * (self.all - self.edge) + f90 * self.edge
        gain = 1 / split.sum(axis=1, keepdims=True) - 1
        return np.asarray(plain * (1 + f0 * gain) if compensated else plain)


def formula(  # noqa: PLR0917 - all of the documented formula
    image: npt.NDArray[np.floating],
    its_sheet: sheet.Sheet,
    surface: Surface,
    split: Float,
    white: Float,
    normals: Float,
    view: Float,
    *,
    switches: bool = True,
) -> Float:
    """The exit radiance (P, 3) that is documented, with both ``switches`` or as the pure theory."""
    diffuse, specular = shading.parts(surface, split, compensated=switches)
    views = np.broadcast_to(view, normals.shape)
    towards, filtered = shading.look_up(normals, views, surface.roughness, bent=switches)
    lit = sheet.radiance(its_sheet, image, towards, filtered)
    return np.asarray(diffuse * white + specular * lit)
