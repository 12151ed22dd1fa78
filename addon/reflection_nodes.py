"""The reflections of *PRT Shading* as nodes; ``prt/specular/shading.py`` is the same in numpy.

What belongs to the light are values of nodes with names: ``Turn 0`` .. ``2``, the rows of the
matrix that takes world directions to the picture's; ``Strength``; for each light cut out of the
picture ``Lamp j``, its irradiance, ``Lamp j direction`` and ``Lamp j half``, where it is in the
world, and ``Lamp j shadow``, how much of its baked shadow is still there.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from math import pi

import bpy
import numpy as np

from . import occlusion_nodes, reflections
from .light_state import LightState
from .node_maths import Maths, Socket
from .prt.job import Peak
from .prt.layout import Layout
from .prt.light import residual
from .prt.specular import look_up, occlusion, shading, sheet, table
from .prt.specular.sheet import Sheet

INPUTS = (
    ("Metallic", "Float", 0.0),
    ("Roughness", "Float", 0.5),
    ("IOR", "Float", 1.5),
    ("Specular IOR Level", "Float", 0.5),
    ("Specular Tint", "Color", (1, 1, 1, 1)),
    ("Normal", "Vector", (0, 0, 0)),
    ("Energy Compensation", "Float", 1.0),
    ("Rough Look-up", "Float", 1.0),
)
FED = ("Base Color", *(name for name, _, _ in INPUTS[:6]))  # by a Principled BSDF's own
SWITCHES = tuple(name for name, _, _ in INPUTS[6:])  # the artist's alone
Inputs = dict[str, Socket]
IMAGE = "prt_reflected"  # of a group: what it reflects


@dataclass(frozen=True)
class View:
    """How a surface is seen: its unit ``normal``, the ``own`` one that no map has bent, ``towards``
    the viewer, the cosine ``n_v``, the ``roughness``, the ``split`` sum's A and B, and in which
    ``direction`` and at which roughness, ``filtered``, radiance is looked up, all of the world."""

    normal: Socket
    own: Socket
    towards: Socket
    n_v: Socket
    roughness: Socket
    split: tuple[Socket, Socket]
    direction: Socket
    filtered: Socket


@dataclass(frozen=True)
class Lobes:
    """How much is reflected: ``f0`` and ``f90`` of dielectric and metal together, ``gain``, what
    energy compensation adds to a reflectance of 1, their sum ``specular``, and ``below``, what the
    diffuse light is multiplied by."""

    f0: Socket
    f90: Socket
    gain: Socket
    specular: Socket
    below: Socket


@dataclass(frozen=True)
class Reflected:
    """What is reflected: the light in ``image``; of the lights cut out of it the baked ``shadows``,
    as far as there are any, and the ``share`` of these that is theirs; what is ``seen``, the
    coefficients of the visibility, or none; and those of the ``transfer``."""

    image: bpy.types.Image
    shadows: Sequence[Socket] = ()
    share: Socket | None = None
    seen: Sequence[Socket] = ()
    transfer: Sequence[Socket] = ()


def exit_radiance(
    tree: bpy.types.NodeTree, inputs: Inputs, white: Socket, light: Reflected
) -> Socket:
    """Of a surface whose Principled BSDF ``inputs`` describe, ``white`` being that of a white
    diffuse one."""
    image, seen = light.image, _view(tree, inputs, light.image)
    lobe = _lobes(tree, inputs, seen)
    make = Maths(tree, 12)
    lit = _radiance(tree, seen, image)
    share = _occlusion(tree, seen, light)
    if share is not None:
        lit = make.vector("MULTIPLY", lit, share)
    total = make.vector(
        "MULTIPLY_ADD", lobe.specular, lit, make.vector("MULTIPLY", lobe.below, white)
    )
    spots = _highlights(tree, seen, lobe, light)
    return total if spots is None else make.vector("ADD", total, spots)


def interface(tree: bpy.types.NodeTree) -> None:
    """The group's further inputs."""
    for name, kind, value in INPUTS:
        socket = tree.interface.new_socket(name, in_out="INPUT", socket_type=f"NodeSocket{kind}")
        socket.default_value = value
        if kind == "Float":
            socket.min_value, socket.max_value = 0.0, 10.0 if name == "IOR" else 1.0


def _view(tree: bpy.types.NodeTree, inputs: Inputs, image: bpy.types.Image) -> View:
    """Normal, viewer and look-up."""
    make, last = Maths(tree, 0), table.SIZE - 1.0
    geometry = make.node("ShaderNodeNewGeometry")
    own, towards = geometry.outputs["Normal"], geometry.outputs["Incoming"]
    given = inputs["Normal"]
    is_given = make.scalar("GREATER_THAN", make.vector("DOT_PRODUCT", given, given), 0.25)
    normal = make.vector("NORMALIZE", make.mixed(own, given, is_given))
    n_v = make.clamped(make.vector("DOT_PRODUCT", normal, towards))
    roughness = make.clamped(inputs["Roughness"])
    mirrored = make.vector("REFLECT", make.vector("MULTIPLY", towards, -1.0), normal)
    across = make.scalar("MULTIPLY_ADD", make.scalar("SQRT", n_v), last, sheet.NODE)
    place = make.joined(across, make.scalar("MULTIPLY_ADD", roughness, last, sheet.NODE))
    make, bent = Maths(tree, 15), inputs["Rough Look-up"]
    texels = _Texels(make, image, place)
    a, b, share = make.parts(texels.colour())
    direction = make.mixed(mirrored, normal, make.scalar("MULTIPLY", share, bent))
    wider = make.scalar("MULTIPLY", make.scalar("SUBTRACT", texels.alpha(), 1.0), bent)
    filtered = make.scalar("MULTIPLY_ADD", roughness, wider, roughness)
    filtered = make.clamped(filtered, 0.0, look_up.ROUGHEST)
    direction = make.vector("NORMALIZE", direction)
    return View(normal, own, towards, n_v, roughness, (a, b), direction, filtered)


def _radiance(tree: bpy.types.NodeTree, seen: View, image: bpy.types.Image) -> Socket:
    """The filtered radiance in the look-up direction."""
    make, its_sheet = Maths(tree, 1), reflections.of(image).sheet
    axes = (tuple(np.eye(3)[k]) for k in range(3))
    x, y, z = (
        make.vector("DOT_PRODUCT", seen.direction, axis, name=f"Turn {k}")
        for k, axis in enumerate(axes)
    )
    u = make.scalar("MULTIPLY_ADD", make.scalar("ARCTAN2", y, x), -0.5 / pi, 0.5)
    up = make.scalar("ARCSINE", make.clamped(z, -1.0, 1.0))
    place = make.joined(u, make.scalar("MULTIPLY_ADD", up, 1 / pi, 0.5))
    lower, upper, share = _places(Maths(tree, 2), seen.filtered, place, its_sheet)
    make = Maths(tree, 3)
    first, second = (_Texels(make, image, place).colour() for place in (lower, upper))
    found = make.mixed(first, second, share)
    positive = make.vector("MAXIMUM", found, (0.0, 0.0, 0.0))
    return make.vector("MULTIPLY", positive, (1.0, 1.0, 1.0), name="Strength")


def _lobes(tree: bpy.types.NodeTree, inputs: Inputs, seen: View) -> Lobes:
    """What is reflected, under light from everywhere, and what the diffuse surface keeps."""
    make, (a, b) = Maths(tree, 4), seen.split
    whole = make.scalar("ADD", a, b)
    lost = make.scalar("SUBTRACT", make.scalar("DIVIDE", 1.0, whole), 1.0)
    gain = make.scalar("MULTIPLY", lost, inputs["Energy Compensation"])
    make = Maths(tree, 5)
    f0, f90 = _dielectric(make, inputs)
    base, metallic = inputs["Base Color"], make.clamped(inputs["Metallic"])
    coat = _reflectance(make, f0, f90, (a, b), gain)
    metal = _reflectance(make, base, 1.0, (a, b), gain)
    kept = make.scalar("SUBTRACT", 1.0, make.largest(coat))
    kept = make.clamped(make.scalar("MULTIPLY", kept, make.scalar("SUBTRACT", 1.0, metallic)))
    return Lobes(
        f0=make.mixed(f0, base, metallic),
        f90=make.mixed(f90, (1.0, 1.0, 1.0), metallic),
        gain=gain,
        specular=make.mixed(coat, metal, metallic),
        below=make.vector("MULTIPLY", base, kept),
    )


def _highlights(
    tree: bpy.types.NodeTree, seen: View, lobe: Lobes, light: Reflected
) -> Socket | None:
    """The highlights of the lights cut out; None where there are none."""
    total, shadows, share = None, light.shadows, light.share
    for j, peak in enumerate(reflections.of(light.image).peaks):
        make = Maths(tree, 6 + j)
        n_l, highlight = _highlight(make, seen, lobe, j, peak.angular_radius)
        if j < len(shadows) and share is not None:
            known = make.scalar("MULTIPLY", share, 0.0, name=f"Lamp {j} shadow")
            n_l = make.scalar("MULTIPLY_ADD", make.scalar("SUBTRACT", shadows[j], n_l), known, n_l)
        lit = make.vector("MULTIPLY", highlight, n_l)
        lit = make.vector("MULTIPLY", lit, (0.0, 0.0, 0.0), name=f"Lamp {j}")
        total = lit if total is None else make.vector("ADD", total, lit)
    return total


def _occlusion(tree: bpy.types.NodeTree, seen: View, light: Reflected) -> Socket | None:
    """How much of what is reflected reaches the surface, a colour; None where nothing is known of
    that."""
    if not light.seen:
        return None
    factors = lobe_factors(tree, seen.filtered, light.image)
    lobe = occlusion_nodes.lobe(tree, light.seen, seen.direction, factors)
    arriving = occlusion_nodes.arriving(tree, light.transfer, seen.own)
    make = Maths(tree, 14)
    return make.mixed(lobe, arriving, make.scalar("MULTIPLY", seen.roughness, seen.roughness))


def lobe_factors(
    tree: bpy.types.NodeTree, roughness: Socket, image: bpy.types.Image
) -> list[Socket]:
    """z_1 .. z_4 of the lobe that radiance is filtered with; z_0 is 1."""
    make, (width, height) = Maths(tree, 11), reflections.of(image).sheet.size
    step = (table.SIZE - 1) / look_up.ROUGHEST
    up = make.scalar("MULTIPLY_ADD", roughness, step, sheet.NODE - 0.5)
    row, part = make.scalar("FLOOR", up), make.scalar("FRACT", up)
    column = 1.5 * sheet.TILE / width
    reads = []
    for k in (0.5, 1.5):
        place = make.joined(column, make.scalar("MULTIPLY_ADD", row, 1 / height, k / height))
        reads.append(_texture(make, image, place))
    colour = make.mixed(*(node.outputs["Color"] for node in reads), part)
    low, high = (node.outputs["Alpha"] for node in reads)
    stored = (*make.parts(colour), make.between(low, high, part))
    return [make.scalar("MULTIPLY_ADD", value, 2.0, -1.0) for value in stored]


def held(node: bpy.types.Node) -> float | tuple[float, ...]:
    """The value of a node that holds one of the light's."""
    value = node.inputs[1].default_value
    return tuple(value) if hasattr(value, "__len__") else value


def values(
    light: LightState, tree: bpy.types.NodeTree, layout: Layout
) -> Iterator[tuple[str, np.ndarray]]:
    """What the named nodes of a group of ``layout`` hold under ``light``, (3,) or () float32."""
    known, rotation = reflections.of(tree[IMAGE]), np.array(light.rotation)
    strength = np.array(light.strength)
    found = {f"Turn {k}": row for k, row in enumerate(rotation)}
    found["Strength"] = known.sheet.scale * strength
    peaks = [_in_world(peak, rotation, strength) for peak in known.peaks]
    for j, peak in enumerate(peaks):
        found[f"Lamp {j}"] = np.array(peak.irradiance)
        found[f"Lamp {j} direction"] = found[f"Lamp {j} half"] = np.array(peak.direction)
        if f"Lamp {j} shadow" in tree.nodes:
            found[f"Lamp {j} shadow"] = np.array(light.shadow_share)
    if layout.visibility_order:
        rest = light.radiance_sh - residual.peaks_sh(tuple(peaks))
        radiance = occlusion.brightened(rest, layout.order)
        found |= {f"M{i}": value for i, value in enumerate(radiance)}
        radiance = radiance * occlusion_nodes.open_factors(layout.order)
        found |= {f"O{i}": value for i, value in enumerate(radiance)}
    for name, value in found.items():
        yield name, np.asarray(value, np.float32)


def _in_world(peak: Peak, rotation: np.ndarray, strength: np.ndarray) -> Peak:
    """``peak`` of the picture as the world has it."""
    direction, irradiance = rotation.T @ peak.direction, strength * peak.irradiance
    return replace(peak, direction=tuple(direction), irradiance=tuple(irradiance))


def _places(
    make: Maths, roughness: Socket, place: Socket, its_sheet: Sheet
) -> tuple[Socket, Socket, Socket]:
    """Where in the image the two levels about ``roughness`` are read, and how far between."""
    at_least = make.scalar("MAXIMUM", roughness, sheet.SHARPEST)
    ratio = make.scalar("DIVIDE", at_least, sheet.SHARPEST)
    steps = make.scalar("MULTIPLY", make.scalar("LOGARITHM", ratio, 2.0), float(sheet.A_DOUBLING))
    level = make.scalar("MINIMUM", make.scalar("FLOOR", steps), sheet.CELLS - 2.0)
    smooth = make.scalar("LESS_THAN", roughness, sheet.SHARPEST)
    above = make.scalar("SUBTRACT", make.scalar("ADD", level, 1.0), smooth)
    in_cell = _scaled(make, place, its_sheet.inner, its_sheet.cell_corner(0))
    in_picture = _scaled(make, place, its_sheet.picture, its_sheet.picture_corner)
    first = make.mixed(_in_cell(make, in_cell, level, its_sheet), in_picture, smooth)
    second = _in_cell(make, in_cell, above, its_sheet)
    squared = make.scalar("POWER", make.scalar("DIVIDE", roughness, sheet.SHARPEST), 2.0)
    between = make.scalar("SUBTRACT", steps, level)
    return first, second, make.scalar("MULTIPLY_ADD", smooth, squared, between)


def _scaled(make: Maths, place: Socket, size: tuple[int, int], corner: tuple[int, int]) -> Socket:
    """``place`` in a map of ``size`` texels at ``corner``, in texels of the image."""
    return make.vector("MULTIPLY_ADD", place, (*map(float, size), 0.0), (*map(float, corner), 0.0))


def _in_cell(make: Maths, first: Socket, level: Socket, its_sheet: Sheet) -> Socket:
    """The place in the cell of ``level`` that ``first`` is in that of the first."""
    column = make.scalar("MODULO", level, float(sheet.COLUMNS))
    row = make.scalar("FLOOR", make.scalar("DIVIDE", level, float(sheet.COLUMNS)))
    cell = (*map(float, its_sheet.cell), 0.0)
    return make.vector("MULTIPLY_ADD", make.joined(column, row), cell, first)


def _dielectric(make: Maths, inputs: Inputs) -> tuple[Socket, Socket]:
    """F0 and F90 of what is not metal."""
    ior = inputs["IOR"]
    edge = make.scalar("DIVIDE", make.scalar("SUBTRACT", ior, 1.0), make.scalar("ADD", ior, 1.0))
    facing = make.scalar("MULTIPLY", edge, edge)
    facing = make.scalar("MULTIPLY", facing, inputs["Specular IOR Level"])
    facing = make.scalar("MULTIPLY", facing, 2.0)
    tinted = make.vector("MULTIPLY", inputs["Specular Tint"], facing)
    f0 = make.vector("MINIMUM", tinted, (1.0, 1.0, 1.0))
    f90 = make.scalar("MULTIPLY", make.largest(f0), shading.EDGE)
    return f0, make.scalar("MINIMUM", f90, 1.0)


def _reflectance(
    make: Maths, f0: Socket, f90: Socket | float, split: tuple[Socket, Socket], gain: Socket
) -> Socket:
    """(F0 A + F90 B) (1 + F0 gain)."""
    a, b = split
    edge = make.scalar("MULTIPLY", b, f90)
    plain = make.vector("MULTIPLY_ADD", f0, a, edge)
    return make.vector("MULTIPLY", plain, _compensation(make, f0, gain))


def _compensation(make: Maths, f0: Socket, gain: Socket) -> Socket:
    return make.vector("MULTIPLY_ADD", f0, gain, (1.0, 1.0, 1.0))


def _highlight(
    make: Maths, seen: View, lobe: Lobes, j: int, radius: float
) -> tuple[Socket, Socket]:
    """Cosine to the light, and D F / (4 ...) without it, the light's irradiance left out."""
    turned = make.vector("DOT_PRODUCT", seen.normal, (0.0, 0.0, 1.0), name=f"Lamp {j} direction")
    n_l = make.clamped(turned)
    half = make.vector("ADD", seen.towards, (0.0, 0.0, 1.0), name=f"Lamp {j} half")
    half = make.vector("NORMALIZE", half)
    n_h = make.clamped(make.vector("DOT_PRODUCT", seen.normal, half))
    v_h = make.clamped(make.vector("DOT_PRODUCT", seen.towards, half))
    wide = make.scalar("POWER", seen.roughness, 4.0)
    wide = make.scalar("MINIMUM", make.scalar("ADD", wide, (radius / 2) ** 2), 1.0)
    cosine = make.scalar("MULTIPLY", n_h, n_h)
    low = make.scalar("MULTIPLY_ADD", cosine, wide, make.scalar("SUBTRACT", 1.0, cosine))
    d = make.scalar("DIVIDE", make.scalar("DIVIDE", wide, 4 * pi), make.scalar("POWER", low, 2.0))
    k = make.scalar("POWER", make.scalar("ADD", seen.roughness, 1.0), 2.0)
    k = make.scalar("DIVIDE", k, 8.0)
    rest = make.scalar("SUBTRACT", 1.0, k)
    for cosine in (n_l, seen.n_v):
        d = make.scalar("DIVIDE", d, make.scalar("MULTIPLY_ADD", cosine, rest, k))
    edge = make.scalar("POWER", make.scalar("SUBTRACT", 1.0, v_h), 5.0)
    fresnel = make.mixed(lobe.f0, lobe.f90, edge)
    fresnel = make.vector("MULTIPLY", fresnel, _compensation(make, lobe.f0, lobe.gain))
    return n_l, make.vector("MULTIPLY", fresnel, d)


class _Texels:
    """What is at ``place``, in texels, as ``prt/specular/reads.py`` finds it."""

    def __init__(self, make: Maths, image: bpy.types.Image, place: Socket) -> None:
        width, height = reflections.of(image).sheet.size
        shifted = make.vector("SUBTRACT", place, (0.5, 0.5, 0.0))
        corner, part = make.vector("FLOOR", shifted), make.vector("FRACTION", shifted)
        self._make = make
        self._right, self._up, _ = make.parts(part)
        scale = (1 / width, 1 / height, 0.0)
        self._four = [
            _texture(make, image, make.vector("MULTIPLY_ADD", corner, scale, centre)).outputs
            for j in (0.5, 1.5)
            for centre in ((0.5 / width, j / height, 0.0), (1.5 / width, j / height, 0.0))
        ]

    def colour(self) -> Socket:
        """Red, green and blue."""
        return self._between("Color", self._make.mixed)

    def alpha(self) -> Socket:
        """The fourth number."""
        return self._between("Alpha", self._make.between)

    def _between(self, output: str, mix: Callable[[Socket, Socket, Socket], Socket]) -> Socket:
        left, right, upper_left, upper_right = (outputs[output] for outputs in self._four)
        upper = mix(upper_left, upper_right, self._right)
        return mix(mix(left, right, self._right), upper, self._up)


def _texture(make: Maths, image: bpy.types.Image, place: Socket) -> bpy.types.Node:
    """One texel: of all interpolations *Closest* alone never takes a mip level."""
    node = make.node("ShaderNodeTexImage")
    node.image, node.interpolation, node.extension = image, "Closest", "EXTEND"
    make.tree.links.new(place, node.inputs["Vector"])
    return node
