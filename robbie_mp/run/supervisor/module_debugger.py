"""The debugger in a module's process: Python's pdb, whose terminal is `robbie attach MODULE`.

At each stop it asks the supervisor for the terminal again, and it gives the terminal back when the module
continues. So the watchdog is held only while the module stands there, and nothing is left behind when the
command or the module dies.
"""

import os
import pdb
import select
import threading
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager
from pathlib import Path
from types import FrameType
from typing import IO, Any, cast

from robbie_mp.run.control import connect
from robbie_mp.run.debug_link import TEXT_CHARACTERS, DebugLink

MAX_WHERE = 300


class TerminalGone(Exception):
    """The terminal has gone, or the run stops: the module goes on."""


class ModuleDebugger(pdb.Pdb):
    """Debugs one thread.

    Args:
        run_folder: the run's folder, with the control socket.
        one_at_a_time: held while a thread of this process stands.
        on_passed: called when the module goes on because there is no terminal.
    """

    def __init__(
        self, run_folder: Path, one_at_a_time: threading.RLock, on_passed: Callable[[], None]
    ) -> None:
        self._terminal = Terminal()
        file = cast("IO[str]", self._terminal)
        # Without .pdbrc: in a current folder such as /tmp, others may have written it, and it is executed.
        super().__init__(stdin=file, stdout=file, nosigint=True, readrc=False)
        self._run_folder = run_folder
        self._one_at_a_time = one_at_a_time
        self._on_passed = on_passed
        self._is_left = False

    def interaction(self, frame: FrameType | None, *what: Any) -> None:
        """Let the user of the terminal look and command; pdb calls this wherever it stops."""
        self._is_left = False
        with self._one_at_a_time:
            try:
                with self._standing(frame):
                    super().interaction(frame, *what)
                    if self._is_left:
                        self._terminal.end()
            except (TerminalGone, OSError):
                self.forget()
                self._is_left = True
                self._on_passed()
        if self._is_left:
            self.clear_all_breaks()
            self.set_continue()

    def do_quit(self, arg: str) -> bool:
        """q(uit) | exit

        Leave the debugger. The module goes on.
        """  # noqa: D415 (pdb prints this as its help)
        self._is_left = True
        return True

    do_q = do_exit = do_quit
    do_EOF = do_quit

    def do_run(self, arg: str) -> None:
        """Run

        Not here: `robbie module restart` restarts a module.
        """  # noqa: D415
        self.error("`robbie module restart` restarts a module")

    do_restart = do_run

    def do_interact(self, arg: str) -> None:
        """Interact

        Not here: type statements at this prompt.
        """  # noqa: D415
        self.error("type statements at this prompt; `!` before one that looks like a command")

    @contextmanager
    def _standing(self, frame: FrameType | None) -> Iterator[None]:
        """Wait for the terminal, and give it back at the end.

        Raises:
            TerminalGone: the module is to go on without one.
        """
        with closing(DebugLink(connect(self._run_folder))) as supervisor:
            supervisor.send({"command": "breakpoint", "where": _place(frame)[:MAX_WHERE]})
            supervisor.receive()
            if (link := supervisor.carried()) is None:
                raise TerminalGone
            with closing(link), self._terminal.opened(link, supervisor):
                yield


class Terminal:
    """The terminal of `robbie attach`, as a file for pdb.

    What pdb says before it asks for commands waits until the terminal is open.
    """

    encoding = "utf-8"

    def __init__(self) -> None:
        self._ends: tuple[DebugLink, DebugLink] | None = None
        self._waiting = ""

    @contextmanager
    def opened(self, link: DebugLink, supervisor: DebugLink) -> Iterator[None]:
        """Be open within the block.

        Args:
            link: to the command.
            supervisor: says when the module is to go on.
        """
        self._ends = link, supervisor
        try:
            waiting, self._waiting = self._waiting, ""
            self.write(waiting)
            yield
        finally:
            self._ends = None

    def write(self, text: str) -> int:
        """Show a text."""
        if self._ends is None:
            self._waiting = (self._waiting + text)[-TEXT_CHARACTERS:]
            return len(text)
        for start in range(0, len(text), TEXT_CHARACTERS):
            self._send({"text": text[start : start + TEXT_CHARACTERS]})
        return len(text)

    def readline(self) -> str:
        """Wait for a line."""
        link, supervisor = self._send({"ask": True})
        ready, _, _ = select.select([link.connection, supervisor.connection], [], [])
        line = link.receive() if link.connection in ready else None
        if line is None or not isinstance(line.get("line"), str):
            raise TerminalGone
        return f"{line['line']}\n"

    def end(self) -> None:
        """Tell the command that its user has left the debugger."""
        self._send({"end": True})

    def flush(self) -> None:
        """Do nothing: every text is sent at once."""

    def isatty(self) -> bool:
        """Return False: no colours."""
        return False

    def _send(self, line: dict[str, object]) -> tuple[DebugLink, DebugLink]:
        """Send a line, but go on if the user's terminal takes nothing while the run stops.

        Raises:
            TerminalGone: the terminal has gone, or the run stops.
        """
        if self._ends is None:
            raise TerminalGone
        link, supervisor = self._ends
        readable, _, _ = select.select([supervisor.connection], [link.connection], [])
        if readable:
            raise TerminalGone
        try:
            link.send(line)
        except OSError:
            raise TerminalGone from None
        return link, supervisor


def _place(frame: FrameType | None) -> str:
    if frame is None:
        return "an exception"
    file = os.path.relpath(frame.f_code.co_filename)
    return f"{file}:{frame.f_lineno} in {frame.f_code.co_name}"
