"""Changes to the document of a .glb, as a careless writer might make them."""

import json
import struct


def rewritten(path, change):
    """The file with ``change`` made to its document."""
    data = path.read_bytes()
    (length,) = struct.unpack_from("<I", data, 12)
    document = json.loads(data[20 : 20 + length])
    change(document)
    text = json.dumps(document).encode()
    text += b" " * (-len(text) % 4)
    rest = data[20 + length :]
    head = struct.pack("<4sIIII", b"glTF", 2, 20 + len(text) + len(rest), len(text), 0x4E4F534A)
    path.write_bytes(head + text + rest)


def of_mesh(**values):
    return lambda document: document["meshes"][0]["extras"]["prt"].update(values)


def of_scene(**values):
    return lambda document: document["scenes"][0]["extras"]["prt_light"].update(values)


def of_texture(**values):
    def change(document):
        document["meshes"][0]["extras"]["prt"]["texture"].update(values)

    return change
