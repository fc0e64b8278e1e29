"""What the trials with the Intel log share: where it is, and the runs that map it."""

import argparse
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from tools.robot import REPOSITORY, Robot, RobotTrouble
from tools.trials.harness import CannotTry

DATA = REPOSITORY.parent / "shared" / "data"
RUN_LIMIT_S = 3600.0

Report = dict[str, Any]


def options(parser: argparse.ArgumentParser) -> None:
    """Add the folder of the log."""
    folder = "folder with intel.clf and intel.relations (../shared/data)"
    parser.add_argument("--data", type=Path, default=DATA, metavar="DIR", help=folder)


def data_of(chosen: argparse.Namespace) -> Path:
    """Return the folder of the command line.

    Raises:
        CannotTry: it has no log.
    """
    data: Path = chosen.data
    if not (data / "intel.clf").exists():
        raise CannotTry(f"{data} has no intel.clf; name its folder with --data")
    return data


def ended(robot: Robot) -> Report:
    """Wait for the end of a run; return its summary.

    Raises:
        RobotTrouble: it has failed.
    """
    summary = robot.wait_for_end(RUN_LIMIT_S)
    if summary["exit_code"]:
        raise RobotTrouble(f"a run has failed: {summary['reason']}")
    return summary


def report_of(runs: Callable[[], Report]) -> Report:
    """Make runs; return what was found, or as a violation that a run itself has failed."""
    try:
        return runs()
    except RobotTrouble as trouble:
        return {"violations": [str(trouble)]}


def is_clean(reports: Sequence[Report]) -> bool:
    """Return whether there is no violation."""
    return not any(report["violations"] for report in reports)
