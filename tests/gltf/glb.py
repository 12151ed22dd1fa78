"""A reader of .glb files, for tests: no code shared with what writes them."""

import json
import struct
from pathlib import Path

import numpy as np
from pngs import pixels_of

DTYPES = {5121: np.uint8, 5122: np.int16, 5123: np.uint16, 5125: np.uint32, 5126: np.float32}
WIDTHS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4}


class Glb:
    """One file: its document, its nodes by name, its arrays."""

    def __init__(self, path: Path):
        self.path = path
        data = path.read_bytes()
        (length,) = struct.unpack_from("<I", data, 12)
        self.document = json.loads(data[20 : 20 + length])
        self.binary = data[28 + length :]
        self.nodes = {node["name"]: node for node in self.document["nodes"]}

    def array(self, index):
        """Accessor ``index`` as (count, width)."""
        accessor = self.document["accessors"][index]
        view = self.document["bufferViews"][accessor["bufferView"]]
        offset = view.get("byteOffset", 0) + accessor.get("byteOffset", 0)
        width, dtype = WIDTHS[accessor["type"]], DTYPES[accessor["componentType"]]
        count = accessor["count"] * width
        values = np.frombuffer(self.binary, dtype, count, offset).reshape(-1, width)
        if accessor.get("normalized") and dtype == np.int16:
            return np.maximum(values / np.float32(32767), -1)
        return values

    def mesh(self, name):
        """The mesh of the node ``name``."""
        return self.document["meshes"][self.nodes[name]["mesh"]]

    def prt(self, name):
        """What the mesh of the node ``name`` says of its bake, None without one."""
        return self.mesh(name).get("extras", {}).get("prt")

    def attributes(self, name):
        """The attributes of every primitive of the node ``name``, as arrays."""
        primitives = self.mesh(name)["primitives"]
        return [{k: self.array(a) for k, a in p["attributes"].items()} for p in primitives]

    def transfer(self, name):
        """Transfer (E, channels, n²) of the node ``name``, its primitives one after the other."""
        prt = self.prt(name)
        channels = ["r", "g", "b"] if prt["channels"] == 3 else [""]
        return self.slots(name, [[f"T{i}{c}" for i in range(prt["order"] ** 2)] for c in channels])

    def slots(self, name, names, direct=False):
        """The floats of the node ``name`` in the slots called ``names``, (E, *shape of names); with
        ``direct`` those without bounces."""
        prt, prefix = self.prt(name), "_PRT_"
        if direct:
            prt, prefix = prt["direct"], "_PRT_DIRECT_"
        if "clusters" in prt:
            return self._of_clusters(name, prt, prefix)[:, np.vectorize(prt["layout"].index)(names)]
        rows = self._rows(name, prefix, len(prt["layout"]))
        values = rows * np.asarray(prt["scale"], np.float32)
        return values[:, np.vectorize(prt["layout"].index)(names)]

    def _rows(self, name, prefix, count):
        """What attributes that begin with ``prefix`` hold, (E, count)."""
        return np.concatenate(
            [
                np.concatenate([a[f"{prefix}{k}"] for k in range(count // 4)], axis=1)
                for a in self.attributes(name)
            ]
        )

    def _of_clusters(self, name, prt, prefix):
        """The floats (E, F) of a bake in clusters."""
        layout, clusters = prt["layout"], prt["clusters"]
        coded = clusters["layout"]
        rows = self._rows(name, prefix, len(coded))
        number = np.rint(32767 * rows[:, coded.index("K")]).astype(int)
        weights = [name for name in coded if name[:1] == "W"]
        book = np.reshape(clusters["values"], (-1, 1 + len(weights), len(layout)))
        values = book[number, 0]
        for j in range(len(weights)):
            values = values + rows[:, [coded.index(f"W{j}")]] * book[number, 1 + j]
        return values

    def atlas(self, name, direct=False):
        """What the pictures of the node ``name`` hold, (N, N, floats), top row first; with
        ``direct`` those without bounces."""
        prt = self.prt(name)["direct"] if direct else self.prt(name)
        scale, offset = (np.array(prt[key]) for key in ("scale", "offset"))
        pictures = [self.picture(index) for index in prt["texture"]["images"]]
        bytes_ = np.concatenate(pictures, axis=2).astype(float)
        size = bytes_.shape[1]
        assert bytes_.shape == (2 * size, size, len(prt["layout"]))
        return offset + scale * (256 * bytes_[:size] + bytes_[size:]) / 65535

    def picture(self, index):
        """The pixels (H, W, 3) of an image."""
        view = self.document["bufferViews"][self.document["images"][index]["bufferView"]]
        start = view.get("byteOffset", 0)
        return pixels_of(self.binary[start : start + view["byteLength"]])

    def world(self, name):
        """The world 3x3 of the node ``name``."""
        return self._world(self.document["nodes"].index(self.nodes[name]))

    def worlds_of_mesh(self, mesh):
        """The world 3x3 of every node that shows ``mesh``."""
        nodes = self.document["nodes"]
        return [self._world(i) for i, node in enumerate(nodes) if node.get("mesh") == mesh]

    def _world(self, index):
        matrix = local(self.document["nodes"][index])
        for parent, node in enumerate(self.document["nodes"]):
            if index in node.get("children", []):
                return self._world(parent) @ matrix
        return matrix


def local(node):
    """The 3x3 of one node."""
    assert "matrix" not in node
    vector, w = np.array(node.get("rotation", [0, 0, 0, 1]))[:3], node.get("rotation", [1])[-1]
    cross = np.cross(vector, np.eye(3)).T
    rotation = np.eye(3) + 2 * (w * cross + cross @ cross)
    return rotation @ np.diag(node.get("scale", [1, 1, 1]))
