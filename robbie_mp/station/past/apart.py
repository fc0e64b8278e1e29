"""Runs `robbie` in a process of its own, which leaves the processors to the robot's modules."""

import os
import subprocess
import sys
from collections.abc import Mapping
from pathlib import Path

NICE = 10
"""The nice value of the process, and of all that it starts."""
_RUN = f"import os, sys; del sys.path[0]; os.nice({NICE}); from robbie_mp.cli import main; sys.exit(main())"


def start_apart(
    arguments: list[str], folder: Path, output: Path, environment: Mapping[str, str] | None = None
) -> "subprocess.Popen[bytes]":
    """Start a command of `robbie`; it ends with this process's module at the latest.

    Args:
        arguments: of the command.
        folder: its current folder.
        output: file that takes what it prints.
        environment: further variables.

    Raises:
        OSError: the process, or the file, cannot be made.
    """
    with output.open("wb") as file:
        return subprocess.Popen(
            [sys.executable, "-c", _RUN, *arguments],
            cwd=folder,
            env={**os.environ, **(environment or {})},
            stdin=subprocess.DEVNULL,
            stdout=file,
            stderr=subprocess.STDOUT,
            start_new_session=True,
        )


def last_line(output: Path) -> str:
    """Return the last line that a process has printed; '' if there is none."""
    try:
        lines = output.read_text(errors="replace").split("\n")
    except OSError:
        return ""
    return next((line.strip() for line in reversed(lines) if line.strip()), "")
