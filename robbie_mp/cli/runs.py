"""The option that chooses the run that a command acts on."""

import argparse

from robbie_mp.run.live_runs import NoSuchRun, choose_run, live_runs, matching_runs

__all__ = ["NoSuchRun", "add_robot_argument", "add_run_argument", "choose_run", "live_runs", "matching_runs"]


def add_run_argument(parser: argparse.ArgumentParser) -> None:
    """Add the option that names a run."""
    run = parser.add_argument(
        "--run",
        metavar="RUN",
        help="the run, by its profile, its folder, or its id or the beginning of it, as `robbie list` shows "
        "them; default: $ROBBIE_RUN, or the run of this workspace, or the only run",
    )
    run.completer = _names  # type: ignore[attr-defined]


def add_robot_argument(parser: argparse.ArgumentParser) -> None:
    """Add the option that has a robot at the other end of the run's link run the command."""
    parser.add_argument(
        "--robot",
        dest="on_robot",
        metavar="NAME",
        help="have this robot run the command, over the link of `robbie connect NAME`; it may refuse to",
    )


def _names(**_: object) -> list[str]:
    runs = live_runs()
    return [run.run_id for run in runs] + [run.record.profile for run in runs if run.record]
