"""What every test needs before Blender starts: a shader cache that lasts, nobody's preferences."""

import atexit
import os
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
STATUS = pytest.StashKey[int]()
USER_RESOURCES = tempfile.TemporaryDirectory(prefix="prt-baker-user-")

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
os.environ.setdefault("MESA_SHADER_CACHE_DIR", str(ROOT / ".cache" / "mesa"))
os.environ["BLENDER_USER_RESOURCES"] = USER_RESOURCES.name
Path(os.environ["MESA_SHADER_CACHE_DIR"]).mkdir(parents=True, exist_ok=True)


def pytest_sessionfinish(session: pytest.Session, exitstatus: int) -> None:
    """Keep the status for the end."""
    session.config.stash[STATUS] = int(exitstatus)


@pytest.hookimpl(trylast=True)
def pytest_unconfigure(config: pytest.Config) -> None:
    """End at once, all being said: Blender 4.5 now and then waits at exit for a thread of its own
    that has gone."""
    USER_RESOURCES.cleanup()
    sys.stdout.flush()
    sys.stderr.flush()
    os._exit(config.stash.get(STATUS, 2))


@pytest.fixture(scope="session")
def root() -> Path:
    """The repository."""
    return ROOT


@pytest.fixture(scope="session")
def registered() -> Iterator[None]:
    """The add-on, switched on; Blender hangs or dies at exit with our classes still registered."""
    import prt_baker

    prt_baker.register()
    done = []

    def unregister() -> None:
        if not done:
            done.append(True)
            prt_baker.unregister()

    atexit.register(unregister)
    yield
    unregister()
