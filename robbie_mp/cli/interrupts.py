"""Ctrl-C while something is imported."""

import signal
from collections.abc import Iterator
from contextlib import contextmanager


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
