"""Which run a command means."""

import argparse

from robbie_mp.errors import RobbieError
from robbie_mp.run.run_directory import KnownRun, list_runs


class NoSuchRun(RobbieError, LookupError):
    """No run, or more than one, fits what was asked for.

    Example scenarios:
      - no robot runs on this machine
      - two run, and the command does not say which
    """


def add_run_argument(parser: argparse.ArgumentParser, *also: str) -> None:
    """Add the argument by which every command names a run, and other names that it has here."""
    run = parser.add_argument(
        "--run", *also, metavar="ID", help="id of the run, if there are several (see `robbie list`)"
    )
    run.completer = lambda **_: [known.run_id for known in live_runs()]  # type: ignore[attr-defined]


def live_runs() -> list[KnownRun]:
    """Return the runs whose supervisor lives, oldest first."""
    return [run for run in list_runs() if run.is_live]


def choose_run(run_id: str | None) -> KnownRun:
    """Return the one run that is meant.

    Raises:
        NoSuchRun: none or several fit.
    """
    runs = live_runs()
    fitting = [run for run in runs if run_id is None or run.run_id.startswith(run_id)]
    if len(fitting) == 1:
        return fitting[0]
    if not runs:
        raise NoSuchRun("no run on this machine; start one with `robbie run PROFILE`")
    described = ", ".join(f"{run.run_id} ({run.record.profile if run.record else '?'})" for run in runs)
    if not fitting:
        raise NoSuchRun(f"no run has the id {run_id}; there are: {described}")
    raise NoSuchRun(f"several runs fit: {described}; say which with --run ID")
