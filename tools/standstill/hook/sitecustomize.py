"""Lets each Python process that starts with this folder in PYTHONPATH spin when it gets a signal.

It spins inside an expression that takes for ever, and so keeps Python's global lock, as a hung library does.
"""

import re
import signal

SPIN = signal.SIGRTMIN + 5


def spin(*_: object) -> None:
    """Never return."""
    re.match("(a+)+$", "a" * 64 + "b")


signal.signal(SPIN, spin)
