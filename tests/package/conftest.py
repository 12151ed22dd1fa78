"""The zips, built once for all tests of this folder."""

import subprocess
import sys
from pathlib import Path

import pytest


@pytest.fixture(scope="session")
def zips(root, tmp_path_factory) -> dict[str, Path]:
    """Platform, as in the manifest: its zip."""
    output = tmp_path_factory.mktemp("zips")
    for tool in (["fetch_wheels.py"], ["package.py", "--output", str(output)]):
        subprocess.run([sys.executable, str(root / "tools" / tool[0]), *tool[1:]], check=True)
    return {path.stem.rsplit("-", 1)[1].replace("_", "-", 1): path for path in output.glob("*.zip")}
