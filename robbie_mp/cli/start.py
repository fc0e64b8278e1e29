"""The entry points of `robbie` and `robbie-top`, which import the program itself.

They import little before they can handle Ctrl-C, because the user may press it at any time.
"""

import signal
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager

INTERRUPTED = 130


def main(arguments: Sequence[str] | None = None) -> int:
    """Run a command; return 0 on success, 1 if it failed, 2 for bad usage or a bad profile."""
    try:
        with interrupts_end_at_once():
            from robbie_mp.cli.program import run_command  # noqa: PLC0415

        return run_command(arguments)
    except KeyboardInterrupt:
        return INTERRUPTED


def top() -> int:
    """Run `robbie top`."""
    return main(["top", *sys.argv[1:]])


@contextmanager
def interrupts_end_at_once() -> Iterator[None]:
    """While entered, Ctrl-C ends the process as if it were not written in Python: without a traceback.

    This is for imports. They leave nothing to clean up, and libraries turn the exception into others. It does
    nothing if the caller handles SIGINT itself.
    """
    try:
        if signal.getsignal(signal.SIGINT) is signal.default_int_handler:
            signal.signal(signal.SIGINT, signal.SIG_DFL)
    except ValueError:  # not in the main thread, which receives all signals
        pass
    try:
        yield
    finally:
        if signal.getsignal(signal.SIGINT) is signal.SIG_DFL:
            signal.signal(signal.SIGINT, signal.default_int_handler)
