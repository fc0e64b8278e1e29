"""What a module takes from elsewhere: in a replay it gets the time of then, and the rest is named."""

import os
import pathlib
import random
import re
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import wraps
from pathlib import Path
from types import CodeType
from typing import Any

from robbie_mp.logs.capsule.place import is_of_library

MOST_NOTED = 5
MOST_FRAMES = 100
CHANCE = "chance without a seed"
TIME = "the exact time"
THREAD = "a thread of its own"
_EVENTS = {
    "socket.connect": "a socket of its own", "socket.bind": "a socket of its own",
    "socket.sendto": "a socket of its own", "subprocess.Popen": "another program",
    "os.system": "another program", "os.posix_spawn": "another program",
}  # fmt: skip
"""Events of Python's audit, and what they show."""
_UNHEARD = re.compile(r"\b(?:datetime\.(?:now|utcnow|today)|date\.today)\(")
"""Clocks that cannot be replaced, and of which Python raises no event."""
_CODE = (".py", ".pyc", ".so")
_NO_CONTENT = ("/dev/null", "/dev/zero", "/dev/urandom", "/dev/random")
_machine_ns = time.monotonic_ns


class TimeOfThen:
    """What Python's own clocks say in a replay: the time at which a step began then, and what passed since.

    Args:
        epoch_ns: what the wall clock said when the monotonic one said 0.
        begin_ns: the monotonic time at which the module started.
    """

    def __init__(self, epoch_ns: int, begin_ns: int):
        self._epoch_ns = epoch_ns
        self._newest_ns = 0
        self.begin(begin_ns)

    def begin(self, step_ns: int) -> None:
        """Go on at the monotonic time of the next step."""
        self._step_ns = step_ns or self._newest_ns
        self._began_ns = _machine_ns()

    def monotonic_ns(self) -> int:
        """Return what `time.monotonic_ns()` said; it does not go back if the replay is slower."""
        self._newest_ns = max(self._newest_ns, self._step_ns + _machine_ns() - self._began_ns)
        return self._newest_ns

    def time_ns(self) -> int:
        """Return what `time.time_ns()` said."""
        return self._epoch_ns + self.monotonic_ns()

    def monotonic(self) -> float:
        """Return what `time.monotonic()` said, in s."""
        return self.monotonic_ns() / 1e9

    def time(self) -> float:
        """Return what `time.time()` said, in s."""
        return self.time_ns() / 1e9

    @contextmanager
    def given(self, outside: "Outside") -> Iterator[None]:
        """Let the functions of `time` say this; modules must be imported within it.

        Args:
            outside: notes who asks, because the time is only roughly that of then.
        """
        functions: dict[str, Callable[[], float]] = {
            "monotonic": self.monotonic, "perf_counter": self.monotonic, "time": self.time,
            "monotonic_ns": self.monotonic_ns, "perf_counter_ns": self.monotonic_ns, "time_ns": self.time_ns,
        }  # fmt: skip
        before = {name: getattr(time, name) for name in functions}
        _set({name: outside.noting(function, lambda *_: TIME) for name, function in functions.items()})
        try:
            yield
        finally:
            _set(before)


def _set(functions: dict[str, Callable[[], float]]) -> None:
    for name, function in functions.items():
        setattr(time, name, function)


class Outside:
    """Notes what code of a workspace takes from where a capsule has nothing of.

    Args:
        workspace: the folder with the code; what libraries do on their own is not noted.
    """

    def __init__(self, workspace: Path):
        self._workspace = os.path.join(workspace, "")
        self._places: dict[str, str] = {}
        self.has_threads = False

    def watch(self) -> None:
        """Note from now on, until this process ends: Python's audit cannot be turned off."""
        for module, name in ((os, "urandom"), (random, "_urandom")):
            setattr(module, name, self.noting(getattr(module, name), lambda *_: CHANCE))
        os.stat = self.noting(os.stat, self._file)
        if accessor := getattr(pathlib, "_NormalAccessor", None):  # Python 3.10 keeps a reference of its own
            accessor.stat = staticmethod(os.stat)
        random.Random.seed = self.noting(  # type: ignore[method-assign]
            random.Random.seed, lambda _, seed=None, *__: CHANCE if seed is None else ""
        )
        threading.Thread.start = self.noting(threading.Thread.start, self._thread)  # type: ignore[method-assign]
        sys.addaudithook(self._hear)

    def noting(self, function: Callable[..., Any], what: Callable[..., str]) -> Callable[..., Any]:
        """Return a function that notes who calls it, and calls another one.

        Args:
            function: that one.
            what: says with the same arguments what is taken from outside; '': nothing.
        """

        @wraps(function)
        def noting(*arguments: Any, **named: Any) -> Any:
            self._note(what(*arguments, **named))
            return function(*arguments, **named)

        return noting

    def _thread(self, *_: Any) -> str:
        self.has_threads = True
        return THREAD

    def _hear(self, event: str, arguments: tuple[Any, ...]) -> None:
        if event == "open":
            self._note(self._file(arguments[0]))
        elif event in _EVENTS:
            self._note(_EVENTS[event])
        elif event == "exec" and isinstance(arguments[0], CodeType):
            self._note_clocks(arguments[0].co_filename)

    def _file(self, path: Any, **_: Any) -> str:
        name = os.fsdecode(path) if isinstance(path, str | bytes | os.PathLike) else ""
        is_content = not name.endswith(_CODE) and name not in _NO_CONTENT
        return f"the file {name.removeprefix(self._workspace)}" if name and is_content else ""

    def _note_clocks(self, name: str) -> None:
        """Note clocks that only the text of an imported file shows."""
        if not self._is_theirs(name):
            return
        try:
            lines = Path(name).read_text(errors="replace").splitlines()
        except OSError:
            return
        for number, line in enumerate(lines, 1):
            if match := _UNHEARD.search(line):
                self._add(f"{match[0]})", f"{Path(name).name}:{number}")

    def _is_theirs(self, file: str) -> bool:
        return file.startswith(self._workspace) and not is_of_library(file)

    def _note(self, what: str) -> None:
        if not what or what in self._places or len(self._places) == MOST_NOTED:
            return
        frame = sys._getframe(1)
        for _ in range(MOST_FRAMES):
            if self._is_theirs(frame.f_code.co_filename):
                self._add(what, f"{Path(frame.f_code.co_filename).name}:{frame.f_lineno}")
                return
            if frame.f_back is None:
                return
            frame = frame.f_back

    def _add(self, what: str, place: str) -> None:
        if what not in self._places and len(self._places) < MOST_NOTED:
            self._places[what] = place

    @property
    def noted(self) -> list[str]:
        """What was taken from outside, with the line that did so first."""
        return [f"{what} ({place})" for what, place in self._places.items()]
