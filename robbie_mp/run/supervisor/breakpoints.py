"""`breakpoint()` in a module's process: it opens the debugger in the terminal of `robbie attach MODULE`.

The debugger itself (`module_debugger`) is imported when a breakpoint is reached for the first time.
"""

import os
import sys
import threading
import time
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from robbie_mp.run.supervisor.module_debugger import ModuleDebugger

VARIABLE = "PYTHONBREAKPOINT"
"""If it is set, it decides what `breakpoint()` does, as everywhere in Python."""
PASSED_S = 0.5
"""For this long after a breakpoint was passed, all are passed: a handler may reach thousands in a second."""


def open_debugger_at_breakpoints(run_folder: Path) -> None:
    """Have `breakpoint()` in this process open the debugger."""
    if VARIABLE not in os.environ:
        sys.breakpointhook = Breakpoints(run_folder)


class Breakpoints:
    """What Python calls at `breakpoint()`.

    Args:
        run_folder: the run's folder, with the control socket.
    """

    def __init__(self, run_folder: Path):
        self._run_folder = run_folder
        self._pid = os.getpid()
        self._one_at_a_time = threading.RLock()
        self._debuggers = threading.local()  # the debugger follows one thread
        self._passed_until_s = 0.0

    def __call__(self, *_: object, **__: object) -> None:
        """Stop behind the caller, unless nobody is attached."""
        if os.getpid() == self._pid and time.monotonic() >= self._passed_until_s:
            self._debugger().set_trace(sys._getframe(1))

    def _debugger(self) -> "ModuleDebugger":
        from robbie_mp.run.supervisor.module_debugger import ModuleDebugger  # noqa: PLC0415

        if not hasattr(self._debuggers, "debugger"):
            made = ModuleDebugger(self._run_folder, self._one_at_a_time, self._pass)
            self._debuggers.debugger = made
        debugger: ModuleDebugger = self._debuggers.debugger
        return debugger

    def _pass(self) -> None:
        self._passed_until_s = time.monotonic() + PASSED_S
