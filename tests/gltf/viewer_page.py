"""The viewer in a real browser, driven by lines of JSON."""

import json
import shutil
import subprocess
from pathlib import Path

from gltf_validator import node_program

HERE = Path(__file__).parent


class Page:
    """A running viewer; close it."""

    def __init__(self):
        program = node_program() or shutil.which("node")
        self._process = subprocess.Popen(
            [program, str(HERE / "browser.mjs")],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
        )
        assert self._answer() == "ready"

    def run(self, body, **files):
        """What ``body`` returns, run in the page as an async function of (viewer, files)."""
        task = {"page": body, "files": {name: str(path) for name, path in files.items()}}
        self._process.stdin.write(json.dumps(task) + "\n")
        self._process.stdin.flush()
        return self._answer()

    def close(self):
        """End the browser with it."""
        self._process.stdin.close()
        self._process.wait(timeout=30)

    def _answer(self):
        line = self._process.stdout.readline()
        assert line, "The browser is gone: see above for why"
        answer = json.loads(line)
        assert "error" not in answer, answer["error"]
        return answer.get("value")
