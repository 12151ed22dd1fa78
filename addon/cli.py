"""The command line: ``blender --command prt_bake`` and ``prt-bake``, and their exit codes.

0 done; 1 a fault of ours, with its traceback; 2 something the user can mend, in one sentence on
standard error; 130 interrupted.  Blender is imported only once the options are understood.
"""

import importlib
import signal
import sys
import traceback
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import FrameType
from typing import Any, Self

from . import options, outputs
from .prt.errors import BakeError

COMMAND = "prt_bake"
PACKAGE = __package__.rpartition(".")[0]  # the add-on, wherever it is installed
_handles: list[Any] = []


def main() -> int:
    """The program ``prt-bake``, on the bpy wheel: opens the .blend itself."""
    return _exit_code("prt-bake", lambda interrupts: _bake_file(sys.argv[1:], interrupts))


def command(arguments: list[str]) -> int:
    """``blender --command prt_bake``: bakes the .blend that Blender has opened."""
    return _exit_code(COMMAND, lambda interrupts: _bake_opened(arguments, interrupts))


class _Interrupts:
    """Ctrl-C and the farm's SIGTERM raise KeyboardInterrupt, inside Blender too.

    ``seen`` remembers them, because Blender makes a RuntimeError of one, or prints and forgets it.
    The second raises nothing, so that the first can clean up.
    """

    def __enter__(self) -> Self:
        self.seen = self._held = False
        signals = (signal.SIGINT, signal.SIGTERM)
        self._before = {number: signal.signal(number, self._interrupt) for number in signals}
        return self

    def __exit__(self, *_error: object) -> None:
        for number, handler in self._before.items():
            signal.signal(number, handler or signal.SIG_DFL)  # None: it was not Python's

    @contextmanager
    def held(self) -> Iterator[None]:
        """Nothing is raised inside: Blender can die of it where it starts or takes in an add-on."""
        self._held = True
        try:
            yield
        finally:
            self._held = False

    def check(self) -> None:
        """Raise what was held back or forgotten."""
        if self.seen:
            raise KeyboardInterrupt

    def _interrupt(self, _number: int, _frame: FrameType | None) -> None:
        first, self.seen = not self.seen, True
        if first and not self._held:
            raise KeyboardInterrupt


def _bake_opened(arguments: list[str], interrupts: _Interrupts) -> None:
    asked = options.parse(COMMAND, arguments, with_blend=False)
    outputs.check(asked.outputs)
    from . import headless

    headless.check_opened(sys.argv)
    headless.run(asked, interrupts.check)


def _bake_file(arguments: list[str], interrupts: _Interrupts) -> None:
    asked = options.parse("prt-bake", arguments, with_blend=True)
    if not asked.blend.is_file():
        raise BakeError(f"{asked.blend} does not exist or is no file")
    outputs.check(asked.outputs)
    with interrupts.held():
        from . import headless

        addon = importlib.import_module(PACKAGE)
        addon.register()
    try:
        interrupts.check()
        headless.open_blend(asked.blend)
        headless.run(asked, interrupts.check)
    finally:
        with interrupts.held():
            addon.unregister()  # what is registered at exit makes some bpy wheels hang


def _exit_code(program: str, work: Callable[[_Interrupts], None]) -> int:
    """Do ``work`` and say how it went."""
    sys.stdout.reconfigure(errors="backslashreplace")  # a name that a console cannot show
    with _Interrupts() as interrupts:
        try:
            work(interrupts)
        except SystemExit as end:  # --help
            return int(end.code or 0)
        except BaseException as error:  # noqa: BLE001 - the last place that can speak
            return _explain(program, error, interrupts.seen)
    return 0


def _explain(program: str, error: BaseException, interrupted: bool) -> int:
    """Tell ``error`` on standard error; its exit code."""
    if interrupted:
        sys.stderr.write(f"{program}: interrupted, nothing was written\n")
        return 130
    if isinstance(error, BakeError):
        sys.stderr.write(f"{program}: {error}\n")
        return 2
    traceback.print_exception(error)
    return 1


def register() -> None:
    """Give Blender the command."""
    import bpy

    _handles.append(bpy.utils.register_cli_command(COMMAND, command))


def unregister() -> None:
    """Take it away."""
    import bpy

    while _handles:
        bpy.utils.unregister_cli_command(_handles.pop())
