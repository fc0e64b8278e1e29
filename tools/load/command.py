"""The command line that all measurements of load share."""

import argparse
import json
import signal
import sys
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any, NoReturn


def command_line(
    name: str, description: str | None, sessions: Iterable[str], *, seconds: float = 60.0, rounds: int = 1
) -> argparse.ArgumentParser:
    """Return a parser with the options of all measurements.

    Args:
        name: of the measurement.
        description: what it does.
        sessions: names of all sessions.
        seconds: duration of each, if the command line says none.
        rounds: number of rounds, likewise.
    """
    parser = argparse.ArgumentParser(
        prog=f"python -m tools.load.{name}",
        description=description,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    add = parser.add_argument
    add("--seconds", type=float, default=seconds, help=f"duration of each session ({seconds:g})")
    add("--rounds", type=int, default=rounds, help=f"number of rounds ({rounds})")
    add("--only", type=lambda text: text.split(";"), default=list(sessions), help="sessions, separated by ;")
    add("--json", type=Path, metavar="FILE", help="also write the results to this file")
    return parser


def write(file: Path | None, machine: dict[str, Any], **figures: Any) -> None:
    """Write the machine, the command and the figures to the file of the command line, if there is one."""
    if file is not None:
        report = {"machine": machine, "command": " ".join(sys.argv), **figures}
        file.write_text(json.dumps(report, indent=1))


def run(main: Callable[[], int]) -> NoReturn:
    """Run a program; the processes that it has started do not outlive it."""
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    try:
        sys.exit(main())
    except KeyboardInterrupt:
        sys.exit(130)
