"""Who may import whom, read from the sources without Blender.

Every guard is also tripped, on sources made up for it.
"""

import ast
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path, PurePosixPath

import pytest

ROOT = Path(__file__).parents[1]
NATIVE = {"embreex", "xatlas", "OpenEXR"}
THREADS = {"threading", "concurrent", "_thread"}
BLENDER = {"bpy", "bpy_extras", "mathutils"}

# part of the engine: the parts of it that it may import beside itself and the modules at its root
ENGINE = {
    "files": set[str](),
    "specular": set[str](),
    "surface": set[str](),
    "atlas": {"surface"},
    "tracing": {"surface"},
    "light": {"files", "surface", "tracing"},
    "vertex": {"surface", "tracing"},
    "texture": {"surface", "tracing", "vertex"},
    "bounces": {"surface", "tracing"},
    "compression": set[str](),
}
WHOLE_ENGINE = {"addon/prt", *(f"addon/prt/{part}" for part in ENGINE)}
PACKAGES = NATIVE | THREADS | {"numpy"}
# part: (the parts that it may import, the packages that it may import)
LAYERS = {
    **{
        f"addon/prt/{part}": ({"addon/prt", *(f"addon/prt/{p}" for p in {part, *below})}, PACKAGES)
        for part, below in ENGINE.items()
    },
    "addon/prt": (WHOLE_ENGINE, PACKAGES),
    "addon": ({"addon", *WHOLE_ENGINE}, BLENDER | {"numpy", "io_scene_gltf2"}),
    "operators": ({"operators", "addon", *WHOLE_ENGINE}, BLENDER),
    "ui": ({"ui", "addon", *WHOLE_ENGINE}, BLENDER),
    "": ({"", "operators", "ui", "addon"}, BLENDER),
}
FUNCTION_LINES, MODULE_LINES = 60, 400
TEXT = {"", ".py", ".sh", ".md", ".toml", ".json", ".lock", ".mjs", ".js", ".cjs", ".txt"}


def part_of(path: PurePosixPath) -> str:
    """The part of the house that a module of the package is in; the root is ""."""
    folder = path.parent.as_posix()
    return "" if folder == "." else folder


def relative_target(path: PurePosixPath, node: ast.ImportFrom, name: str) -> str:
    """The part that ``from ...module import name`` in ``path`` reaches."""
    folder = [part for part in path.parent.parts if part != "."]
    if node.level - 1 > len(folder):
        return "outside"
    kept = folder[: len(folder) - node.level + 1]
    whole = [*kept, *(node.module or "").split("."), name]
    parts = [part for part in LAYERS if part and whole[: part.count("/") + 1] == part.split("/")]
    return max(parts, key=len, default="")


def imports(path: PurePosixPath, tree: ast.Module) -> Iterator[tuple[bool, str]]:
    """Each import as (relative, the part or the top-level package that it reaches)."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            yield from ((False, alias.name.split(".")[0]) for alias in node.names)
        elif isinstance(node, ast.ImportFrom) and node.level == 0:
            yield False, str(node.module).split(".")[0]
        elif isinstance(node, ast.ImportFrom):
            yield from ((True, relative_target(path, node, a.name)) for a in node.names)


def import_breaches(sources: dict[str, str]) -> list[str]:
    """What the imports of ``sources`` (path: text) do against the layers."""
    found, native_users = [], dict[str, set[str]]()
    for name, text in sources.items():
        path = PurePosixPath(name)
        parts, packages = LAYERS[part_of(path)]
        for relative, target in imports(path, ast.parse(text)):
            if target in NATIVE:
                native_users.setdefault(target, set()).add(name)
            standard = target in sys.stdlib_module_names and target not in THREADS
            if not (target in parts if relative else target in packages or standard):
                found.append(f"{name} imports {'.' * relative}{target}")
    return found + [
        f"{package} is imported in {sorted(users)}"
        for package, users in native_users.items()
        if len(users) > 1
    ]


def path_edits(sources: dict[str, str]) -> list[str]:
    """Modules that touch ``sys.path`` or ``sys.modules``, which an extension may not."""
    return [
        name
        for name, text in sources.items()
        for node in ast.walk(ast.parse(text))
        if isinstance(node, ast.Attribute)
        and node.attr in {"path", "modules"}
        and isinstance(node.value, ast.Name)
        and node.value.id == "sys"
    ]


def shadowing(names: list[str]) -> list[str]:
    """Files called like a module of the standard library, or like one that Blender imports."""
    taken = sys.stdlib_module_names | {"attrs"}
    return [name for name in names if PurePosixPath(name).stem in taken]


def too_long(sources: dict[str, str]) -> list[str]:
    """Functions and modules that are no longer read in one go."""
    found = [name for name, text in sources.items() if text.count("\n") > MODULE_LINES]
    for name, text in sources.items():
        for node in ast.walk(ast.parse(text)):
            if isinstance(node, ast.FunctionDef):
                length = (node.end_lineno or 0) - node.lineno + 1
                found += [f"{name}: {node.name}"] * (length > FUNCTION_LINES)
    return found


def tracked(*patterns: str) -> list[str]:
    """The files of the repository that match ``patterns``, new ones not yet added included."""
    command = ["git", "ls-files", "--cached", "--others", "--exclude-standard", "--", *patterns]
    names = subprocess.run(command, cwd=ROOT, check=True, capture_output=True, text=True).stdout
    return [name for name in names.splitlines() if (ROOT / name).is_file()]


@pytest.fixture(scope="module")
def package() -> dict[str, str]:
    """The sources of the package."""
    names = [name for name in tracked("*.py") if part_of(PurePosixPath(name)) in LAYERS]
    return {name: (ROOT / name).read_text("utf-8") for name in names}


@pytest.fixture(scope="module")
def python_sources() -> dict[str, str]:
    """Every Python file of the repository."""
    return {name: (ROOT / name).read_text("utf-8") for name in tracked("*.py")}


def test_imports_keep_the_layers(package):
    assert package["addon/prt/sh.py"]
    assert import_breaches(package) == []


def test_nothing_edits_the_import_path(package):
    assert path_edits(package) == []


def test_no_file_shadows_a_module():
    assert shadowing(tracked("*.py")) == []


def test_no_two_test_files_have_one_name():
    """pytest imports them by that name alone."""
    names = [PurePosixPath(name).name for name in tracked("tests/**/test_*.py")]
    assert len(names) == len(set(names)) > 50


def test_functions_and_modules_stay_short(python_sources):
    assert too_long(python_sources) == []


def test_every_part_is_installed(root):
    listed = [line.strip(' ",') for line in (root / "pyproject.toml").read_text().splitlines()]
    for part in LAYERS:
        assert ".".join(["prt_baker", *part.split("/")]).strip(".") in listed


@pytest.mark.parametrize(
    ("path", "line"),
    [
        ("addon/prt/sh.py", "import bpy"),
        ("addon/prt/sh.py", "from mathutils import Vector"),
        ("addon/prt/sh.py", "import scipy.special"),
        ("addon/prt/sh.py", "from .. import stamp"),
        ("addon/prt/sh.py", "from ..stamp import Stamp"),
        ("addon/prt/sh.py", "def late():\n    import bpy"),
        ("addon/prt/surface/points.py", "from ..tracing import rays"),
        ("addon/prt/tracing/rays.py", "from ..vertex.fit import Fit"),
        ("addon/prt/light/world.py", "from ...stamp import Stamp"),
        ("addon/scene.py", "import scipy"),
        ("addon/scene.py", "import embreex"),
        ("addon/scene.py", "import threading"),
        ("addon/scene.py", "from concurrent.futures import ThreadPoolExecutor"),
        ("addon/scene.py", "from ..operators import bake"),
        ("addon/scene.py", "from ..ui.panel import PRT_PT_bake"),
        ("addon/scene.py", "import prt_baker.addon.stamp"),
        ("addon/scene.py", "from ... import other_extension"),
        ("operators/bake.py", "from ..ui import panel"),
        ("operators/bake.py", "from .. import ui"),
        ("ui/panel.py", "from ..operators.bake import PRT_OT_bake"),
        ("ui/panel.py", "from .. import register"),
        ("__init__.py", "import numpy"),
    ],
)
def test_a_breach_is_found(path, line):
    assert len(import_breaches({path: line})) == 1


@pytest.mark.parametrize(
    ("path", "line"),
    [
        ("addon/prt/rays.py", "from . import sh\nfrom .job import Job\nimport embreex, json"),
        ("addon/prt/rays.py", "from concurrent.futures import ThreadPoolExecutor"),
        ("addon/prt/light/world.py", "from ..tracing.rays import Occlusion\nfrom .. import sh"),
        ("addon/scene.py", "import bpy\nfrom .prt import sh\nfrom .prt.job import Job"),
        ("operators/bake.py", "from ..addon import scene\nfrom .driver import run"),
        ("ui/panel.py", "import bpy\nfrom ..addon import stamp"),
        ("__init__.py", "from .operators import bake\nfrom . import ui"),
    ],
)
def test_what_is_allowed_passes(path, line):
    assert import_breaches({path: line}) == []


def test_a_native_package_in_two_modules_is_found():
    twice = {"addon/prt/a.py": "import OpenEXR", "addon/prt/b.py": "import OpenEXR"}
    assert import_breaches(twice) == ["OpenEXR is imported in ['addon/prt/a.py', 'addon/prt/b.py']"]


def test_the_other_guards_trip():
    assert path_edits({"addon/a.py": "import sys\nsys.path.append('x')"}) == ["addon/a.py"]
    assert shadowing(["addon/prt/json.py", "tests/attrs.py", "addon/prt/sh.py"]) == [
        "addon/prt/json.py",
        "tests/attrs.py",
    ]
    long = "def f():\n" + "    x = 1\n" * FUNCTION_LINES
    assert too_long({"a.py": long}) == ["a.py: f"]
    assert too_long({"a.py": "x = 1\n" * (MODULE_LINES + 1)}) == ["a.py"]


def test_the_repository_names_no_machine():
    ours = Path(__file__).relative_to(ROOT).as_posix()
    words = ["/" + "root/", "/" + "work/", "py" + "pi.org", "python" + "hosted", "npm" + "js."]
    words += ["deb." + "debian"]
    text = [name for name in tracked() if Path(name).suffix in TEXT]
    found = [
        (name, word)
        for name in text
        for word in words
        if name != ours and word in (ROOT / name).read_text("utf-8")
    ]
    assert found == []
