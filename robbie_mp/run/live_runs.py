"""The runs on this machine, and choosing one of them."""

import os
from collections.abc import Sequence
from pathlib import Path

from robbie_mp.base.errors import RobbieError
from robbie_mp.run.profile.workspace import enclosing_workspace
from robbie_mp.run.run_directory import KnownRun, list_runs

RUN_VARIABLE = "ROBBIE_RUN"
"""The environment variable that names a run where no option does."""


class NoSuchRun(RobbieError, LookupError):
    """No run, or more than one, matches what was asked for.

    Example scenarios:
      - no robot runs on this machine
      - two robots run in this workspace, and the command or script does not name one
    """


def live_runs() -> list[KnownRun]:
    """Return the runs whose supervisor is alive, oldest first."""
    return [run for run in list_runs() if run.is_live]


def choose_run(named: str | None, how: str = "--run") -> KnownRun:
    """Return the run that is meant; see `matching_runs`.

    Args:
        named: the run's id or its beginning, its profile, or its folder; None: none is named.
        how: how the user can choose one, for the error.

    Raises:
        NoSuchRun: no run, or more than one, matches.
    """
    runs = live_runs()
    fitting = matching_runs(named, runs)
    if len(fitting) == 1:
        return fitting[0]
    if not runs:
        raise NoSuchRun("no run on this machine; start one with `robbie run PROFILE`")
    if not fitting:
        raise NoSuchRun(f"no run is called {_name(named)}; there are: {_described(runs)}")
    raise NoSuchRun(f"several runs match: {_described(fitting)}; choose one with {how} and its id")


def matching_runs(named: str | None, runs: Sequence[KnownRun]) -> list[KnownRun]:
    """Return the runs that a user may mean.

    Of the runs with this name, those of the workspace around the current folder come first, and then all.

    Args:
        named: the run's id or its beginning, its profile, or its workspace or folder for results; None: what
            `ROBBIE_RUN` names, if it is set.
        runs: all runs.
    """
    name = _name(named)
    called = [run for run in runs if _is_called(run, name)] if name else list(runs)
    if len(called) < 2:
        return called
    here = _here()
    return [run for run in called if run.record and run.record.workspace == here] or called


def _name(named: str | None) -> str:
    return named or os.environ.get(RUN_VARIABLE, "")


def _is_called(run: KnownRun, name: str) -> bool:
    record = run.record
    if run.run_id.startswith(name) or record is None:
        return run.run_id.startswith(name)
    is_profile = record.profile in (name, f"robbie:{name}")
    return is_profile or os.path.realpath(name) in (record.workspace, record.output_directory)


def _here() -> str:
    """Return the workspace around the current folder; outside of one, the current folder."""
    here = Path.cwd()
    return os.path.realpath(enclosing_workspace(here) or here)


def _described(runs: Sequence[KnownRun]) -> str:
    return ", ".join(
        f"{run.run_id} ({run.record.profile} in {run.record.workspace})" if run.record else run.run_id
        for run in runs
    )
