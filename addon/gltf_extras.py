"""What another program may have put into a file's extras: read, checked and turned to Blender's
frame.  The schema is in docs/gltf.md; errors are sentences."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from math import isqrt
from typing import Any

import numpy as np
import numpy.typing as npt

from .gltf_attributes import BASIS, BOUNCES, INCLUDES, LARGEST, VERSION
from .gltf_frame import Y_UP, turn_matrix
from .light_state import LightState
from .prt import sh
from .prt.errors import BakeError
from .prt.job import LIGHT_ORDER, Peak
from .prt.layout import DIRECT, PREFIX, Layout

IMAGE_KEY = "glTF"  # no image of this file's
STORED = ("layout", "scale", "offset", "texture", "clusters", "direct")  # how floats are stored
Float = npt.NDArray[np.float64]


@dataclass(frozen=True)
class FileBake:
    """``mesh.extras.prt``: ``columns`` (4 k) are the places of the slots of ``layout`` in the
    file's floats (F), -1 where unused, ``scale`` (F) what the file's floats are multiplied with,
    ``offset`` (F) what is added then, and ``matrix`` (3, 3) the world matrix when baked, Z up.
    ``bounces`` is whether light of other surfaces is inside.  Of a bake in pictures ``images`` are
    their numbers, and they are read at TEXCOORD_``tex_coord``; one in ``clusters`` has the file's
    floats in these.  Names of its attributes begin with ``prefix``.  ``direct`` is the same without
    bounces, where the file has that."""

    layout: Layout
    columns: tuple[int, ...]
    scale: Float
    matrix: Float
    bounces: bool
    offset: Float
    images: tuple[int, ...] = ()
    tex_coord: int = 0
    clusters: "Clusters | None" = None
    prefix: str = PREFIX
    direct: "FileBake | None" = None

    @property
    def attributes(self) -> tuple[str, ...]:
        """What the file has of it."""
        floats = len(self.clusters.layout if self.clusters else self.scale)
        return tuple(f"{self.prefix}{k}" for k in range(0 if self.images else floats // 4))

    @property
    def both(self) -> tuple["FileBake", ...]:
        """It, and the one without bounces where there is one."""
        return (self,) if self.direct is None else (self, self.direct)

    def decoded(self, attributes: npt.NDArray[np.float32]) -> npt.NDArray[np.float32]:
        """The file's floats (E, F), of what its attributes hold (E, 4 k)."""
        return attributes if self.clusters is None else self.clusters.decoded(attributes)

    def arranged(self, stored: npt.NDArray[np.float32]) -> npt.NDArray[np.float32]:
        """The file's floats (..., F) in the order of ``layout``, as they are meant."""
        arranged = np.zeros((*stored.shape[:-1], len(self.columns)), np.float32)
        for k, column in enumerate(self.columns):
            if column >= 0:
                arranged[..., k] = stored[..., column] * self.scale[column] + self.offset[column]
        return arranged


@dataclass(frozen=True)
class Clusters:
    """Attributes hold, as ``layout`` names it, the cluster K and weights W0, W1, ...; ``book``
    (K, 1 + N, F) has the mean and the directions of each cluster."""

    layout: tuple[str, ...]
    book: Float

    def decoded(self, attributes: npt.NDArray[np.float32]) -> npt.NDArray[np.float32]:
        """What ``attributes`` (E, 4 k) stand for, (E, F); BakeError where they name a cluster that
        is not there."""
        numbers = np.rint(LARGEST * attributes[:, self.layout.index("K")]).astype(int)
        count = len(self.book)
        wrong = numbers[(numbers < 0) | (numbers >= count)]
        _check(
            not len(wrong), f"a vertex is of cluster {max(wrong, default=0)}, and there are {count}"
        )
        values = self.book[numbers, 0]
        for j in range(self.book.shape[1] - 1):
            weight = attributes[:, self.layout.index(f"W{j}")]
            values += weight[:, None] * self.book[numbers, 1 + j]
        return values.astype(np.float32)


def read_bake(prt: Any) -> FileBake:
    """``mesh.extras.prt``; BakeError says what is wrong with it."""
    _check(isinstance(prt, Mapping), "its extras say nothing of the bake")
    version, order, channels = prt.get("version"), prt.get("order"), prt.get("channels")
    _check(version == VERSION, f"its bake has version {version}, and this add-on knows {VERSION}")
    _check(order in range(1, 6), f"order {order} is none of 1 to 5")
    _check(channels in {1, 3}, f"{channels} channels are neither 1 nor 3")
    _check(prt.get("frame") == "world", f'frame "{prt.get("frame")}" is not "world"')
    _check(prt.get("basis") == BASIS, f'basis "{prt.get("basis")}" is not that of version 1')
    includes = prt.get("includes")
    known = (INCLUDES, INCLUDES + BOUNCES)
    _check(includes in known, f'"{includes}" is not what a transfer of version 1 includes')
    slots, texture = prt.get("layout"), prt.get("texture")
    width, words = (4, "four names an attribute") if texture is None else (3, "three a picture")
    if "clusters" in prt:
        width, words = 1, "names"
    named = isinstance(slots, Sequence) and bool(slots) and len(slots) % width == 0
    _check(named and not isinstance(slots, str), f"layout is not {words}")
    layout = _layout(prt, slots)
    scale = np.ones(len(slots)) if prt.get("scale") == 1 else prt.get("scale")
    scale = _numbers(scale, (len(slots),), f"scale is neither 1 nor {len(slots)} numbers")
    matrix = _numbers(prt.get("matrix"), (9,), "matrix is not nine numbers")
    _check(bool(matrix.any()), "matrix is all zeros")
    columns = tuple(slots.index(name) if name else -1 for name in layout.slots)
    turned = turn_matrix(matrix, Y_UP.T)
    offset = np.zeros(len(slots)) if texture is None else prt.get("offset")
    offset = _numbers(offset, (len(slots),), f"offset is not {len(slots)} numbers")
    bake = FileBake(layout, columns, scale, turned, includes != INCLUDES, offset)
    if "clusters" in prt:
        bake = replace(bake, clusters=_clusters(prt["clusters"], len(slots)))
    bake = bake if texture is None else _in_texture(bake, texture)
    return replace(bake, direct=_direct(prt, bake)) if "direct" in prt else bake


def _direct(prt: Mapping[str, Any], whole: FileBake) -> FileBake:
    """What ``prt`` says of the same without bounces."""
    says = prt["direct"]
    _check(whole.bounces, "it has direct light apart, and no bounces")
    _check(isinstance(says, Mapping), "direct says nothing")
    common = {key: value for key, value in prt.items() if key not in STORED}
    bake = read_bake({**common, "channels": 1, "includes": INCLUDES, **says})
    _check(bake.layout == whole.layout.direct, "direct has another layout than without bounces")
    places = {(bool(its.images), its.tex_coord) for its in (bake, whole)}
    _check(len(places) == 1, "direct does not lie where the whole does")
    return replace(bake, prefix=DIRECT)


def _in_texture(bake: FileBake, texture: Any) -> FileBake:
    """``bake`` with what ``texture`` says."""
    _check(isinstance(texture, Mapping), "texture says nothing of its pictures")
    images, tex_coord, count = texture.get("images"), texture.get("texCoord"), len(bake.scale) // 3
    listed = isinstance(images, Sequence) and len(images) == count
    _check(listed and all(map(_is_index, images)), f"texture has not {count} images")
    _check(_is_index(tex_coord), f"texCoord {tex_coord} is no number of a TEXCOORD")
    return replace(bake, images=tuple(images), tex_coord=tex_coord)


def _clusters(clusters: Any, floats: int) -> Clusters:
    """``clusters`` of bakes of so many ``floats``."""
    _check(isinstance(clusters, Mapping), "clusters say nothing")
    layout, values = clusters.get("layout"), clusters.get("values")
    names = layout if isinstance(layout, Sequence) and not isinstance(layout, str) else ()
    used = [name for name in names if name]
    expected = {"K", *(f"W{j}" for j in range(len(used) - 1))}
    whole = len(used) > 1 and len(names) % 4 == 0 and set(used) == expected
    _check(whole, "the clusters' layout is not K, W0, W1, …")
    width = len(used) * floats
    sentence = f"the clusters' values are not {width} numbers each"
    counted = isinstance(values, Sequence) and bool(values) and len(values) % width == 0
    _check(counted, sentence)
    book = _numbers(values, (len(values),), sentence)
    return Clusters(tuple(names), book.reshape(-1, len(used), floats))


def _is_index(value: Any) -> bool:
    return isinstance(value, int) and not isinstance(value, bool) and value >= 0


def _layout(prt: Mapping[str, Any], slots: Sequence[str]) -> Layout:
    """What ``slots`` hold, all of it or BakeError."""
    turns = prt.get("turns", int("R0r" in slots))
    _check(turns in range(25), f"{turns} turns are none of 0 to 24")
    lights, seen = (
        sum(isinstance(name, str) and name[:1] == letter for name in slots) for letter in "SV"
    )
    _check(seen in {0, 4, 9, 16, 25}, f"{seen} visibilities are none of 4, 9, 16 and 25")
    layout = Layout(prt["order"], prt["channels"], turns, lights, isqrt(seen))
    expected, found = [s for s in layout.slots if s], [s for s in slots if s]
    for name in expected:
        _check(name in found, f"layout has no {name}")
    _check(len(found) == len(expected), "layout has names that its order and channels don't")
    return layout


def read_light(light: Any) -> LightState:
    """``scene.extras.prt_light``, Z up; BakeError says what is wrong with it."""
    _check(isinstance(light, Mapping), "the scene has no prt_light in its extras")
    order = light.get("order")
    _check(order in range(1, 6), f"the light's order {order} is none of 1 to 5")
    now, baked = (
        _coefficients(light.get(name), order, name) for name in ("radiance_sh", "baked_radiance_sh")
    )
    lights = light.get("lights", [])
    _check(isinstance(lights, Sequence) and len(lights) <= 4, "more than four lights are cut out")
    peaks = tuple(_peak(one) for one in lights)
    return LightState(IMAGE_KEY, now, now, baked, follows=False, peaks=peaks)


def _coefficients(values: Any, order: int, name: str) -> Float:
    sentence = f"the light's {name} is not {order**2} triples of numbers"
    padded = np.zeros((LIGHT_ORDER**2, 3))
    padded[: order**2] = _numbers(values, (order**2, 3), sentence)
    return sh.rotate(padded, Y_UP.T)


def _peak(light: Any) -> Peak:
    sentence = "a cut-out light of the scene is not whole"
    _check(isinstance(light, Mapping), sentence)
    direction = _numbers(light.get("direction"), (3,), sentence)
    irradiance = _numbers(light.get("irradiance"), (3,), sentence)
    radius = _numbers(light.get("angular_radius"), (), sentence)
    _check(bool(np.linalg.norm(direction)), sentence)
    x, y, z = (Y_UP.T @ (direction / np.linalg.norm(direction))).tolist()
    r, g, b = irradiance.tolist()
    return Peak((x, y, z), (r, g, b), float(radius))


def _numbers(values: Any, shape: tuple[int, ...], sentence: str) -> Float:
    """``values`` as finite numbers of ``shape``, or BakeError."""
    try:
        array = np.array(values, np.float64)
    except (TypeError, ValueError) as error:
        raise BakeError(sentence) from error
    _check(array.shape == shape and bool(np.isfinite(array).all()), sentence)
    return array


def _check(holds: bool, sentence: str) -> None:
    if not holds:
        raise BakeError(sentence)
