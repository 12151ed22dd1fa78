"""Switching the add-on on and off, in a Blender of its own."""

import subprocess
import sys

OURS = "PRT_"


def python(code):
    """What a fresh interpreter prints."""
    command = [sys.executable, "-c", code]
    done = subprocess.run(command, check=False, capture_output=True, text=True, timeout=120)
    assert done.returncode == 0, done.stderr
    return done.stdout


def test_importing_needs_no_blender():
    assert "no Blender" in python(
        "import sys, prt_baker, prt_baker.addon.cli, prt_baker.addon.options\n"
        "print('no Blender' if 'bpy' not in sys.modules else 'bpy')"
    )


def test_the_package_has_no_other_surprises():
    assert "AttributeError" in python(
        "import prt_baker\n"
        "assert not hasattr(prt_baker, 'glTF2ExportUserExtensions')\n"
        "try:\n    prt_baker.nothing\nexcept AttributeError as error:\n    print(repr(error))"
    )


def test_exporter_and_importer_find_their_classes(scene):
    import prt_baker

    assert hasattr(prt_baker, "glTF2ExportUserExtension")
    assert hasattr(prt_baker, "glTF2ImportUserExtension")


INVENTORY = f"""
import bpy, prt_baker

def inventory():
    lists = [getattr(bpy.app.handlers, name) for name in dir(bpy.app.handlers)]
    handlers = [len(value) for value in lists if isinstance(value, list)]
    types = [name for name in dir(bpy.types) if name.startswith({OURS!r})]
    return handlers, types, dir(bpy.ops.prt), hasattr(bpy.types.Scene, "prt")

before = inventory()
"""


def test_unregistering_leaves_nothing_and_it_can_be_switched_on_again():
    printed = python(
        INVENTORY + "for _ in range(3):\n"
        "    prt_baker.register()\n"
        "    assert inventory() != before\n"
        "    prt_baker.unregister()\n"
        "    assert inventory() == before, (inventory(), before)\n"
        "print('clean')"
    )
    assert "clean" in printed


def test_registering_twice_is_loud():
    printed = python(
        "import prt_baker\n"
        "prt_baker.register()\n"
        "try:\n    prt_baker.register()\nexcept ValueError as error:\n    print('loud')\n"
        "prt_baker.unregister()"
    )
    assert "loud" in printed


def test_it_registers_in_blenders_restricted_state():
    printed = python(
        "import bpy, addon_utils\nmade = addon_utils.enable('prt_baker', default_set=True)\n"
        "assert made is not None\n"
        "print(bpy.context.preferences.addons.keys(), hasattr(bpy.types.Scene, 'prt'))\n"
        "addon_utils.disable('prt_baker', default_set=True)"
    )
    assert "True" in printed
