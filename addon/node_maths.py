"""Formulas as nodes: each operation is a node, its arguments sockets or numbers."""

import bpy

Socket = bpy.types.NodeSocket
Number = float | tuple[float, float, float]
Argument = Socket | Number
STEP = 180
NUMBERS = ("DOT_PRODUCT", "LENGTH")  # operations on vectors that give one


class Maths:
    """Adds nodes to ``tree``, each to the right of the last, ``row`` rows down."""

    def __init__(self, tree: bpy.types.NodeTree, row: int) -> None:
        self.tree = tree
        self._x, self._y = 0, -1000 - 400 * row

    def node(self, kind: str, name: str = "") -> bpy.types.Node:
        """A new node, called ``name`` where it is looked up later."""
        node = self.tree.nodes.new(kind)
        node.location = self._x, self._y
        self._x += STEP
        if name:
            node.name = node.label = name
        return node

    def scalar(self, operation: str, *arguments: Argument, name: str = "") -> Socket:
        """A Math node's result."""
        node = self.node("ShaderNodeMath", name)
        node.operation = operation
        self._feed(node, arguments)
        return node.outputs[0]

    def vector(self, operation: str, *arguments: Argument, name: str = "") -> Socket:
        """A Vector Math node's result, a number where it gives one."""
        node = self.node("ShaderNodeVectorMath", name)
        node.operation = operation
        self._feed(node, arguments)
        return node.outputs["Value" if operation in NUMBERS else "Vector"]

    def clamped(self, value: Argument, low: float = 0.0, high: float = 1.0) -> Socket:
        """``value``, a number, between two bounds."""
        return self.scalar("MINIMUM", self.scalar("MAXIMUM", value, low), high)

    def mixed(self, first: Argument, second: Argument, share: Argument) -> Socket:
        """From the vector ``first`` to ``second``."""
        return self.vector("MULTIPLY_ADD", self.vector("SUBTRACT", second, first), share, first)

    def between(self, first: Argument, second: Argument, share: Argument) -> Socket:
        """From the number ``first`` to ``second``."""
        return self.scalar("MULTIPLY_ADD", self.scalar("SUBTRACT", second, first), share, first)

    def parts(self, vector: Socket) -> tuple[Socket, Socket, Socket]:
        """Its three numbers."""
        node = self.node("ShaderNodeSeparateXYZ")
        self.tree.links.new(vector, node.inputs[0])
        return node.outputs[0], node.outputs[1], node.outputs[2]

    def joined(self, x: Argument, y: Argument, z: Argument = 0.0) -> Socket:
        """A vector of three numbers."""
        node = self.node("ShaderNodeCombineXYZ")
        self._feed(node, (x, y, z))
        return node.outputs[0]

    def largest(self, vector: Socket) -> Socket:
        """Of its three numbers."""
        x, y, z = self.parts(vector)
        return self.scalar("MAXIMUM", self.scalar("MAXIMUM", x, y), z)

    def _feed(self, node: bpy.types.Node, arguments: tuple[Argument, ...]) -> None:
        """To its inputs, in their order."""
        for socket, argument in zip(node.inputs, arguments, strict=False):
            if isinstance(argument, bpy.types.NodeSocket):
                self.tree.links.new(argument, socket)
            elif hasattr(socket.default_value, "__len__"):
                wide = isinstance(argument, tuple)
                socket.default_value = argument if wide else (argument,) * 3
            else:
                socket.default_value = argument
