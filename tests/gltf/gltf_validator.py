"""What npm gltf-validator says, and the schema of our extras."""

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

HERE = Path(__file__).parent


def node_program():
    """node: $NODE, that of this environment, or that on PATH."""
    beside = shutil.which("node", path=str(Path(sys.executable).parent))
    return os.environ.get("NODE") or beside or shutil.which("node")


def assert_valid(path):
    """No error, and no warning, says gltf-validator; our extras are as docs/gltf.schema.json
    says."""
    program = node_program()
    assert program, "gltf-validator needs node: make test installs it"
    run = subprocess.run(
        [program, str(HERE / "validate.mjs"), str(path)], capture_output=True, text=True, check=True
    )
    said = json.loads(run.stdout)
    issues = said["issues"]
    assert issues["numErrors"] == issues["numWarnings"] == 0, issues["messages"]
    assert not said["extras"], said["extras"]
