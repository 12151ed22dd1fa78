"""The nodes of ``prt/specular/occlusion.py``: how much of what is reflected reaches the surface.

    lobe = clamp(sum over l of z_l (sum over m of V_lm Y_lm(R)))
    arriving = clamp(sum of T_i M_i / sum of O_i Y_i(N))

Each ``Y_lm`` is a polynomial in the height z of its direction times ``cos m phi`` or ``sin m phi``,
which are polynomials in x and y.  The nodes ``M0``, ``M1``, ... hold the light, ``O0``, ``O1``, ...
the same times what ``open_factors`` says.
"""

from collections.abc import Sequence
from math import factorial, pi, sqrt

import bpy
import numpy as np

from .node_maths import Maths
from .prt import sh

Socket = bpy.types.NodeSocket
Term = Socket | float


def lobe(
    tree: bpy.types.NodeTree,
    seen: Sequence[Socket],
    direction: Socket,
    factors: Sequence[Socket],
) -> Socket:
    """The share, 0 to 1, of a lobe about the unit ``direction`` with the zonal ``factors`` z_1,
    z_2, ... (of as many bands or more) that reaches the sky, where ``seen`` are V_0, V_1, ..."""
    order = sh.order_of(len(seen))
    nodes = _Arithmetic(tree)
    values = _basis(nodes, direction, order)
    total: Term = 0.0
    for band in range(order):
        of_band: Term = 0.0
        for i in range(sh.index(band, -band), sh.index(band, band) + 1):
            of_band = nodes.plus(nodes.times(seen[i], values[i]), of_band)
        total = nodes.plus(nodes.times(of_band, factors[band - 1] if band else 1.0), total)
    return nodes.clamped(total)


def arriving(tree: bpy.types.NodeTree, transfer: Sequence[Socket], normal: Socket) -> Socket:
    """The share, 0 to 1, of an open surface's irradiance that arrives, a colour, where ``transfer``
    are T_0, T_1, ..., numbers or colours, and ``normal`` is the one that it is baked for."""
    values = _basis(_Arithmetic(tree), normal, sh.order_of(len(transfer)))
    make = Maths(tree, 13)
    sums: list[Socket] = []
    for letter, factors in (("M", transfer), ("O", values)):
        total: Socket | float = 0.0
        for i, factor in enumerate(factors):
            total = make.vector("MULTIPLY_ADD", factor, 0.0, total, name=f"{letter}{i}")
        sums.append(total)
    ratio = make.vector("DIVIDE", *sums)
    bounded = make.vector("MAXIMUM", ratio, (0.0, 0.0, 0.0))
    return make.vector("MINIMUM", bounded, (1.0, 1.0, 1.0))


def open_factors(order: int) -> np.ndarray:
    """What (n², 1) the harmonics at a normal are multiplied by in the open surface's transfer."""
    return (sh.clamped_cosine(order) / pi)[sh.bands(order), None]


def _basis(nodes: "_Arithmetic", direction: Socket, order: int) -> list[Term]:
    """The harmonics (n²) of ``order`` bands in the unit ``direction``."""
    x, y, z = nodes.apart(direction)
    squared = nodes.times(z, z) if order > 2 else z
    circles: list[tuple[Term, Term]] = [(1.0, 0.0), (x, y)]
    for _ in range(2, order):
        c, s = circles[-1]
        cosine = nodes.plus(nodes.times(x, c), nodes.times(nodes.times(y, s), -1.0))
        circles.append((cosine, nodes.plus(nodes.times(x, s), nodes.times(y, c))))
    values: list[Term] = [0.0] * order**2
    for band in range(order):
        for m in range(band + 1):
            height = nodes.polynomial(_height(band, m), z, squared)
            cosine, sine = circles[m]
            values[sh.index(band, m)] = nodes.times(cosine, height)
            if m:
                values[sh.index(band, -m)] = nodes.times(sine, height)
    return values


def _height(band: int, m: int) -> list[float]:
    """Coefficients, of z to the power 0, 1, ..., of what Y(band, ±m) has beside cos m phi and sin
    m phi times the radius about the axis to the power m."""
    size = sqrt((2 * band + 1) / (4 * pi) * factorial(band - m) / factorial(band + m))
    size *= sqrt(2) if m else 1
    legendre = np.polynomial.legendre.Legendre.basis(band).deriv(m)
    powers = legendre.convert(kind=np.polynomial.Polynomial).coef
    return [float(size * c) if (band - m - k) % 2 == 0 else 0.0 for k, c in enumerate(powers)]


class _Arithmetic:
    """Sums and products of sockets and numbers in ``tree``; what is known makes no node."""

    def __init__(self, tree: bpy.types.NodeTree) -> None:
        self._tree, self._made = tree, 0
        self._products: set[str] = set()  # nodes that can still take a summand in

    def apart(self, vector: Socket) -> list[Socket]:
        """Its three components."""
        node = self._new("ShaderNodeSeparateXYZ")
        self._tree.links.new(vector, node.inputs[0])
        return list(node.outputs)

    def times(self, a: Term, b: Term) -> Term:
        """Their product."""
        if isinstance(a, float) and isinstance(b, float):
            return a * b
        if 0.0 in (a, b):
            return 0.0
        if isinstance(a, float):
            a, b = b, a
        if b == 1.0:
            return a
        product = self._math("MULTIPLY", a, b)
        self._products.add(product.node.name)
        return product

    def plus(self, a: Term, b: Term) -> Term:
        """Their sum; a product just made takes it in, as a multiply-add."""
        if isinstance(a, float) and isinstance(b, float):
            return a + b
        if isinstance(a, float):
            a, b = b, a
        if b == 0.0:
            return a
        if a.node.name in self._products and not a.is_linked:
            self._products.remove(a.node.name)
            a.node.operation = "MULTIPLY_ADD"
            self._put(b, a.node.inputs[2])
            return a
        return self._math("ADD", a, b)

    def polynomial(self, powers: Sequence[float], z: Socket, squared: Term) -> Term:
        """The sum of ``powers[k]`` times z to the power k, all even or all odd."""
        odd = len(powers) % 2 == 0
        value: Term = 0.0
        for power in powers[::-1][::2]:
            value = self.plus(self.times(value, squared), power)
        return self.times(value, z) if odd else value

    def clamped(self, value: Term) -> Socket:
        """Held between 0 and 1."""
        node = self._math("ADD", value, 0.0).node
        node.use_clamp = True
        return node.outputs[0]

    def _math(self, operation: str, a: Term, b: Term) -> Socket:
        node = self._new("ShaderNodeMath")
        node.operation = operation
        self._put(a, node.inputs[0])
        self._put(b, node.inputs[1])
        return node.outputs[0]

    def _put(self, value: Term, place: Socket) -> None:
        if isinstance(value, float):
            place.default_value = value
        else:
            self._tree.links.new(value, place)

    def _new(self, kind: str) -> bpy.types.Node:
        node = self._tree.nodes.new(kind)
        node.location = (1200 + 180 * (self._made // 12), -1200 - 180 * (self._made % 12))
        self._made += 1
        return node
