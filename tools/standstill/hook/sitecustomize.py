"""Lets each Python process that starts with this folder in PYTHONPATH spin when it gets a signal.

It spins inside an expression that takes for ever, and so keeps Python's global lock, as a hung library does.
Its name, which others can read, then says since when (us, monotonic clock).
"""

import re
import signal
import time
from pathlib import Path

SPIN = signal.SIGRTMIN + 5
NAME = "@"


def spin(*_: object) -> None:
    """Never return."""
    Path("/proc/self/comm").write_text(f"{NAME}{time.monotonic_ns() // 1000}")
    re.match("(a+)+$", "a" * 64 + "b")


signal.signal(SPIN, spin)
