"""Choosing the run that a command acts on."""

import argparse

from robbie_mp.errors import RobbieError
from robbie_mp.run.run_directory import KnownRun, list_runs


class NoSuchRun(RobbieError, LookupError):
    """No run, or more than one, matches the command's --run.

    Example scenarios:
      - no robot runs on this machine
      - two robots run, and the command does not name one
    """


def add_run_argument(parser: argparse.ArgumentParser, *also: str) -> None:
    """Add the option that names a run, and further names for it."""
    run = parser.add_argument(
        "--run",
        *also,
        metavar="ID",
        help="id of the run, or its beginning, if there are several (see `robbie list`)",
    )
    run.completer = lambda **_: [known.run_id for known in live_runs()]  # type: ignore[attr-defined]


def live_runs() -> list[KnownRun]:
    """Return the runs whose supervisor is alive, oldest first."""
    return [run for run in list_runs() if run.is_live]


def choose_run(run_id: str | None) -> KnownRun:
    """Return the run with this id, or the only run if it is None.

    Raises:
        NoSuchRun: no run, or more than one, matches.
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
    raise NoSuchRun(f"several runs match: {described}; choose one with --run ID")
