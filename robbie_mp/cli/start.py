"""The entry points of `robbie` and `robbie-top`, which import the program itself.

They import little before they can handle Ctrl-C, because the user may press it at any time.
"""

import sys
from collections.abc import Sequence

from robbie_mp.cli.interrupts import interrupts_end_at_once

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
