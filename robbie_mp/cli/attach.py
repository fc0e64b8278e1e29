"""`robbie attach MODULE`: debug a module that stands at a breakpoint, in this terminal."""

import argparse
import contextlib
import signal
import sys
import termios
from collections.abc import Iterator
from contextlib import closing
from importlib import import_module

from robbie_mp.base.visible_text import visible
from robbie_mp.cli import completers
from robbie_mp.cli.output import say
from robbie_mp.cli.parser import Commands, add_command
from robbie_mp.cli.runs import add_run_argument, choose_run
from robbie_mp.run.control import ControlRefused, connect
from robbie_mp.run.debug_link import DebugLink

SOON_S = 0.3
"""A module that steps stands again sooner."""

LOOK_EVERY_S = 0.1
"""How often to check, while the user types, whether the module is still there."""

MAX_PROMPT = 1 << 14
"""Characters of an unfinished line, which may be the prompt; a longer one is none, and is shown at once."""


class _ModuleGone(Exception):
    """The module has ended, or goes on, while the user types."""


class _Left(Exception):
    """The user has left the debugger."""


def add_parser(subparsers: Commands) -> None:
    """Add `attach` to the commands."""
    parser = add_command(
        subparsers,
        "attach",
        "debug a module at its breakpoints",
        "Open Python's debugger (pdb) in this terminal whenever the module reaches `breakpoint()` in its "
        "code. Call it before or after: a module waits 60 s at a breakpoint, and its watchdog waits, too. "
        "Ctrl-D or q leaves; then the module goes on, and passes its breakpoints. Restarts of the module do "
        "not end the command.",
        ["robbie attach laser", "robbie attach laser --run demo"],
    )
    name = parser.add_argument("module", help="name of the module")
    name.completer = completers.modules  # type: ignore[attr-defined]
    add_run_argument(parser)
    parser.set_defaults(command=attach)


def attach(arguments: argparse.Namespace) -> int:
    """Be the terminal of a module."""
    run, name = choose_run(arguments.run), arguments.module
    with contextlib.suppress(ImportError):
        import_module("readline")  # lets the user edit what input() reads
    with closing(DebugLink(connect(run.folder))) as supervisor:
        supervisor.send({"command": "debug", "module": name})
        reply = supervisor.receive() or {}
        if "done" not in reply:
            raise ControlRefused(str(reply.get("error", "the run has ended")))
        say(f"{reply['done']}; it stops here at its next breakpoint(), Ctrl-C leaves")
        with contextlib.suppress(_Left, KeyboardInterrupt):
            _attend(supervisor, name)
            say("the run has ended")
            return 0
    say(f"left; {name} goes on")
    return 0


def _attend(supervisor: DebugLink, name: str) -> None:
    """Debug the module wherever it stands, until the run ends.

    Raises:
        _Left: the user has left.
    """
    while (line := supervisor.receive()) is not None:
        if "note" in line:
            say(str(line["note"]))
        terminal = supervisor.carried() if "stopped" in line else None
        if terminal is not None:
            with closing(terminal):
                _debug(terminal)
            if not supervisor.has_news(SOON_S):
                say(f"{name} runs")


def _debug(terminal: DebugLink) -> None:
    """Show what the debugger says, and send it what the user types, until the module goes on.

    Raises:
        _Left: the user has left.
    """
    shown = ""
    while (line := terminal.receive()) is not None:
        if "end" in line:
            raise _Left
        lines, newline, shown = (shown + str(line.get("text", ""))).rpartition("\n")
        if len(shown) > MAX_PROMPT:
            lines, newline, shown = lines + newline, shown, ""
        print(lines + newline, end="", flush=True)
        if "ask" in line:
            try:
                terminal.send({"line": _typed(terminal, shown)})
            except (_ModuleGone, OSError):
                print(flush=True)
                _forget_typed()
                return
            shown = ""
    print(shown, end="", flush=True)


def _forget_typed() -> None:
    """Drop the line that is not finished: it was meant for a module that is gone."""
    with contextlib.suppress(termios.error, OSError):  # it is no terminal
        termios.tcflush(sys.stdin, termios.TCIFLUSH)


def _typed(terminal: DebugLink, prompt: str) -> str:
    """Wait for a line of the user.

    Raises:
        _Left: there are no more.
        _ModuleGone: the module has gone meanwhile.
    """
    while True:
        try:
            with _interrupted_by(terminal), contextlib.redirect_stdout(sys.__stdout__):
                return input(visible(prompt))  # without our stream between, so that the line can be edited
        except EOFError:
            print(flush=True)
            raise _Left from None
        except KeyboardInterrupt:
            print("\nCtrl-D leaves", flush=True)


@contextlib.contextmanager
def _interrupted_by(terminal: DebugLink) -> Iterator[None]:
    """Raise `_ModuleGone` within the block when the module says something or goes: nobody has asked it to.

    Python's line editor waits only for the keyboard, so a timer interrupts it regularly.
    """
    is_typing = True

    def leave(_signal: int, _frame: object) -> None:
        if is_typing and terminal.has_news(0):
            raise _ModuleGone

    before = signal.signal(signal.SIGALRM, leave)
    signal.setitimer(signal.ITIMER_REAL, LOOK_EVERY_S, LOOK_EVERY_S)
    try:
        yield
    finally:
        is_typing = False
        signal.setitimer(signal.ITIMER_REAL, 0)
        signal.signal(signal.SIGALRM, before)
