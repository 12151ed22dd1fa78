"""Radiance filtered with the lobe of a roughness, over the whole sphere.

Every texel of a level is the mean of the picture under ``brdf.lobe`` about its direction, with the
solid angles of the picture's texels.  No direction is drawn at random, so there is no noise, and a
sun of one texel gives a clean highlight.  Along azimuth the sums are products of Fourier
coefficients.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from functools import lru_cache
from math import ceil, log2
from typing import Any

import numpy as np
import numpy.typing as npt

from ..parallel import workers
from . import reads

Array = npt.NDArray[np.float32]
Float = npt.NDArray[np.float64]
Complex = npt.NDArray[np.complexfloating]

SOURCES = (128, 256, 512, 1024)  # widths of the picture that a level is made of
FINE = 7.0  # of its texels in the lobe's alpha
WINDOW = 32.0  # alphas from the lobe's middle that still count, for sharp lobes; 0.4 % lie further
SMOOTH = 20.0  # azimuths of the lobe, times its alpha, beyond which its series holds nothing
SHARP = 0.05  # the largest alpha that does with a window
SMOOTH_ALPHA = 0.02  # from here on a level is smooth enough for reads to be balanced


def resampled(pixels: Array, height: int, width: int) -> Array:
    """Means (height, width, 3) of ``pixels`` (H, W, 3) over the solid angles of larger or smaller
    texels."""
    if pixels.shape[:2] == (height, width):
        return pixels
    columns = np.linspace(0, pixels.shape[1], width + 1)
    rows = np.linspace(0, np.pi, height + 1)
    narrowed = np.empty((len(pixels), width, 3), np.float32)
    for start in range(0, len(pixels), 64):
        block = pixels[start : start + 64]
        narrowed[start : start + 64] = _sums(block, columns, axis=1) * (width / pixels.shape[1])
    heights = -np.diff(np.cos(np.linspace(0, np.pi, len(pixels) + 1)))
    places = rows / np.pi * len(pixels)
    # within a row of the picture radiance is constant, so what counts is how much of z is inside
    inside = np.minimum(places.astype(np.int64), len(pixels) - 1)
    above = np.cos(inside * np.pi / len(pixels)) - np.cos(rows)
    edges = inside + above / heights[inside]
    result = np.empty((height, width, 3), np.float32)
    for start in range(0, width, 64):
        flux = narrowed[:, start : start + 64] * heights[:, None, None]
        result[:, start : start + 64] = _sums(flux, edges, axis=0)
    return np.asarray(result / -np.diff(np.cos(rows)).astype(np.float32)[:, None, None])


def levels(
    pixels: Array, roughness: npt.ArrayLike, height: int, width: int, threads: int = 0
) -> Iterator[Array]:
    """For each ``roughness`` above 0, the filtered ``pixels`` (H, W, 3) as a lat-long map
    (height, width, 3), top row first: the values, and where they are smooth what linear reads
    between texels come nearest to them with."""
    source: _Source | None = None
    for alpha in np.square(np.asarray(roughness, np.float64)).tolist():
        wide = next((w for w in SOURCES if w >= FINE * 2 * np.pi / alpha), SOURCES[-1])
        if source is None or source.width != wide:
            source = _Source.of(pixels, wide)
        values = _filtered(source, alpha, (height, width), threads)
        yield _balanced(values) if alpha >= SMOOTH_ALPHA else values


@dataclass(frozen=True)
class _Source:
    """A picture of ``width`` columns and half as many rows: ``spectra`` (H, M, 3), the Fourier
    coefficients along azimuth of each row's flux, and ``solid_angles`` (H,), a texel's."""

    width: int
    spectra: Complex
    solid_angles: Float

    @classmethod
    def of(cls, pixels: Array, width: int) -> "_Source":
        """``pixels`` (H, W, 3) about the centres of coarser texels.

        What is halved goes to the two nearest centres along each axis, by its distance: moved
        whole, a sun would stand up to half a texel off.
        """
        if pixels.shape[1] <= width:
            picture = resampled(pixels, width // 2, width)
            angles = _solid_angles(picture)
            return cls._of_flux(picture * angles.astype(np.float32)[:, None, None], angles)
        picture = resampled(pixels, width, 2 * width)
        flux = picture * _solid_angles(picture).astype(np.float32)[:, None, None]
        flux = _to_nearest(np.concatenate([flux[:, -1:], flux, flux[:, :1]], axis=1), 1)
        beyond = [np.roll(edge, width // 2, axis=1) for edge in (flux[:1], flux[-1:])]  # the poles
        solid_angles = 2 * _solid_angles(picture)
        return cls._of_flux(
            _to_nearest(np.concatenate([beyond[0], flux, beyond[1]]), 0),
            _to_nearest(np.pad(solid_angles, 1, mode="edge"), 0),
        )

    @classmethod
    def _of_flux(cls, flux: Array, solid_angles: Float) -> "_Source":
        spectra = np.fft.rfft(flux, axis=1)
        width = flux.shape[1]
        half_texel = np.exp(-1j * np.pi * np.arange(spectra.shape[1]) / width)
        return cls(width, np.asarray(spectra * half_texel[:, None], np.complex64), solid_angles)


def _solid_angles(picture: Array) -> Float:
    """Of a texel of each row (H,)."""
    height, width = picture.shape[:2]
    return np.asarray(-np.diff(np.cos(np.linspace(0, np.pi, height + 1))) * 2 * np.pi / width)


def _to_nearest(flux: npt.NDArray[Any], axis: int) -> npt.NDArray[Any]:
    """Halved along ``axis``, which has one element more at both ends."""
    moved = np.moveaxis(flux, axis, 0)
    near, far = moved[1:-1], (moved[:-2:2], moved[3::2])
    return np.moveaxis(0.75 * (near[::2] + near[1::2]) + 0.25 * (far[0] + far[1]), 0, axis)


def _filtered(source: _Source, alpha: float, shape: tuple[int, int], threads: int) -> Array:
    """The level of ``alpha``, whose row i and row -1 - i have one lobe."""
    height, width = shape
    azimuths = min(source.width, max(SOURCES[0], 2 ** ceil(log2(SMOOTH / alpha))))
    count = min(width, azimuths) // 2  # frequencies
    # both halves of the sphere at once, as real numbers: (frequencies, 12, rows)
    halves = [source.spectra[:, :count], source.spectra[::-1, :count]]
    both = np.ascontiguousarray(np.concatenate(halves, axis=2))  # older numpy keeps their order
    kept = np.ascontiguousarray(both.view(np.float32).transpose(1, 2, 0))
    forward = np.exp(1j * np.pi * np.arange(count) / width)[:, None] * width

    def pair(row: int) -> Float:
        theta = (row + 0.5) * np.pi / height
        rows, lobe = _lobe(theta, source.solid_angles, azimuths, alpha)
        along = np.ascontiguousarray(lobe[:, :count].T)[:, :, None]
        sums = np.ascontiguousarray(np.matmul(kept[:, :, rows], along)[..., 0])
        return np.asarray(np.fft.irfft(sums.view(np.complex64) * forward, width, axis=0))

    result = np.empty((height, width, 3), np.float32)
    with workers(threads) as pool:
        for row, found in enumerate(pool.map(pair, range((height + 1) // 2))):
            result[row], result[-1 - row] = found[:, :3], found[:, 3:]
    return np.maximum(result, 0)


def _lobe(theta: float, solid_angles: Float, azimuths: int, alpha: float) -> tuple[slice, Array]:
    """The rows of the picture that the lobe about ``theta`` reaches, and its cosine series along
    azimuth there, (rows, azimuths): over all texels it adds up to 1."""
    height = len(solid_angles)
    step = np.pi / height
    reach = WINDOW * alpha if alpha < SHARP else np.pi
    rows = slice(max(0, int((theta - reach) / step)), min(height, int((theta + reach) / step) + 1))
    centres = (np.arange(rows.start, rows.stop) + 0.5) * step
    # sin² of half the angle between the directions; the cosine would lose the peak's digits
    apart = np.square(np.sin(0.5 * (centres - theta)))
    across = np.sin(theta) * np.sin(centres)
    half = (apart[:, None] + across[:, None] * _half_azimuths(azimuths)).astype(np.float32)
    squared = np.float32(alpha * alpha)
    lobe = np.maximum(1 - 2 * half, 0) / np.square(half + squared * (1 - half))
    series = np.fft.irfft(lobe, azimuths, axis=1)
    whole = series[:, 0] @ solid_angles[rows] * 2 * height
    return rows, np.asarray(series / whole, np.float32)


@lru_cache(maxsize=8)
def _half_azimuths(width: int) -> Float:
    """sin² of half the azimuth of every column, up to half a turn."""
    return np.asarray(np.square(np.sin(np.pi * np.arange(width // 2 + 1) / width)))


def _balanced(values: Array) -> Array:
    """``values`` (h, w, 3) over the response of reads, along great circles over the poles and along
    the parallels, both of which close."""
    height, width = values.shape[:2]
    circles = np.concatenate([values, np.roll(values[::-1], width // 2, axis=1)])
    for axis in (0, 1):
        spectra = np.fft.rfft(circles, axis=axis)
        frequency = np.arange(spectra.shape[axis]) * 2 * np.pi / circles.shape[axis]
        factors = 1 / reads.response(frequency)
        spectra *= factors[:, None, None] if axis == 0 else factors[:, None]
        circles = np.fft.irfft(spectra, circles.shape[axis], axis=axis)
    return circles[:height].astype(np.float32)


def _sums(values: npt.NDArray[np.floating], edges: Float, axis: int) -> Float:
    """Integrals between ``edges``, in elements along ``axis``, of ``values`` constant over each."""
    moved = np.moveaxis(values, axis, 0)
    before = np.zeros((len(moved) + 1, *moved.shape[1:]))
    np.cumsum(moved, axis=0, dtype=np.float64, out=before[1:])
    whole = np.minimum(edges.astype(np.int64), len(moved) - 1)
    part = (edges - whole).reshape(-1, *[1] * (moved.ndim - 1))
    return np.moveaxis(np.diff(before[whole] + part * moved[whole], axis=0), 0, axis)
