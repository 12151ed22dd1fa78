"""A Blender on a screen of its own, seen and touched from outside like an artist's."""

import json
import os
import shutil
import subprocess
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

HERE = Path(__file__).parent
EXTENSION = "bl_ext.user_default.prt_baker"
DISPLAYS = {"trixie": ":78", "sid": ":79"}
SIZE = (1600, 1000)
SETTLE = 0.5  # seconds between two things that a hand does


class RealBlender:
    """A Debian suite's Blender and, once ``open`` was called, its window.

    Everything that both sides see lies in ``folder``, below the shared /tmp.
    """

    def __init__(self, suite: str) -> None:
        self.suite = suite
        self.folder = Path(tempfile.mkdtemp(prefix=f"real-blender-{suite}-", dir="/tmp"))
        self.resources = self.folder / "resources"
        self.temporary = self.folder / "temporary"
        self.resources.mkdir()
        self.temporary.mkdir()
        self._processes: list[subprocess.Popen[bytes]] = []

    def chroot(self, verb: str, *arguments: object) -> list[str]:
        """The command line of chroot.sh."""
        return [str(HERE / "chroot.sh"), verb, self.suite, *map(str, arguments)]

    @property
    def environment(self) -> dict[str, str]:
        """What chroot.sh reads."""
        display = DISPLAYS[self.suite]
        return {
            **os.environ,
            "BLENDER_USER_RESOURCES": str(self.resources),
            "TMPDIR": str(self.temporary),
            "DISPLAY": display,
        }

    def run(self, *command: object) -> subprocess.CompletedProcess[str]:
        """Run a program in the chroot to its end."""
        return subprocess.run(
            self.chroot("run", *command),
            env=self.environment,
            capture_output=True,
            text=True,
            timeout=300,
            check=False,
        )

    def _start(self, log: str, *command: object) -> None:
        with (self.folder / log).open("wb") as file:
            process = subprocess.Popen(
                self.chroot("run", *command), env=self.environment, stdout=file, stderr=file
            )
        self._processes.append(process)

    def open(self) -> None:
        """Start screen and Blender, with the extension and session.py's scene."""
        width, height = SIZE
        screen = f"{width}x{height}x24"
        self._start("x.log", "Xvfb", DISPLAYS[self.suite], "-screen", 0, screen, "-nolisten", "tcp")
        time.sleep(2)
        shutil.copy(HERE / "session.py", self.folder)
        window = ["--window-geometry", 0, 0, width, height]
        script = ["--python", self.folder / "session.py", "--", self.folder]
        addon = ["--factory-startup", "--addons", EXTENSION]
        self._start("blender.log", "blender", *addon, *window, *script)
        self.wait(bool, "the window", 120)

    def close(self) -> None:
        """Stop what ``open`` started."""
        for process in reversed(self._processes):
            process.terminate()
            process.wait(30)

    def state(self) -> dict[str, Any]:
        """What session.py says last."""
        values: dict[str, Any] = json.loads((self.folder / "state.json").read_text())
        return values

    def wait(
        self, wanted: Callable[[dict[str, Any]], bool], what: str, seconds: float = 240
    ) -> dict[str, Any]:
        """Wait until the state is as wanted; AssertionError with Blender's log otherwise."""
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            if (self.folder / "state.json").exists() and wanted(state := self.state()):
                return state
            if self._processes[-1].poll() is not None:
                break
            time.sleep(0.1)
        log = (self.folder / "blender.log").read_text(errors="replace")
        raise AssertionError(f"{what} did not come in {seconds:.0f} s\n{log[-3000:]}")

    def ask(self, action: str) -> None:
        """Have session.py do one of its actions."""
        before = self.state()["done"].count(action)
        (self.folder / "action").write_text(action)
        self.wait(lambda state: state["done"].count(action) > before, action, 120)

    def touch(self, *words: object) -> None:
        """One thing that a hand does, as xdotool says it."""
        result = self.run("xdotool", *words)
        assert result.returncode == 0, result.stderr
        time.sleep(SETTLE)

    def click(self, x: int, y: int) -> None:
        """Move there and press the left button; slow, for Blender redraws slowly here."""
        self.touch("mousemove", x, y)
        self.touch("mousedown", 1)
        self.touch("mouseup", 1)

    def screenshot(self, name: str) -> np.ndarray:
        """The screen as (height, width, 3) uint8, kept as ``folder/name.png``."""
        png, raw = self.folder / f"{name}.png", self.folder / "screen.rgb"
        for command in (["import", "-window", "root", png], ["convert", png, "-depth", 8, raw]):
            done = self.run(*command)
            assert done.returncode == 0, done.stderr
        return np.frombuffer(raw.read_bytes(), np.uint8).reshape(SIZE[1], SIZE[0], 3)

    def canvas(self, picture: np.ndarray) -> np.ndarray:
        """The part of a screenshot where the 3D view shows the scene, left of the sidebar."""
        state = self.state()
        left, top, _, height = state["window"]
        return crop(picture, [left, top + 60, state["sidebar"][0] - left, height - 60])

    def settled(
        self, name: str, wanted: Callable[[np.ndarray], bool] = lambda picture: True
    ) -> np.ndarray:
        """A screenshot that is as wanted and changes no more."""
        end = time.monotonic() + 240
        before = self.screenshot(name)
        while time.monotonic() < end:
            time.sleep(3)
            now = self.screenshot(name)
            if wanted(now) and difference(now, before) < 0.02:
                return now
            before = now
        raise AssertionError(f"The screen never came to rest, see {self.folder / name}.png")


def difference(first: np.ndarray, second: np.ndarray) -> float:
    """The mean difference of two pictures, in steps of 255."""
    return float(np.abs(first.astype(float) - second).mean())


def crop(picture: np.ndarray, place: list[int]) -> np.ndarray:
    """The part of a screenshot at ``place`` (left, top, width, height)."""
    left, top, width, height = place
    return picture[top : top + height, left : left + width]
