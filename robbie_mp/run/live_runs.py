"""The runs on this machine, and choosing one of them."""

from robbie_mp.base.errors import RobbieError
from robbie_mp.run.run_directory import KnownRun, list_runs


class NoSuchRun(RobbieError, LookupError):
    """No run, or more than one, matches what was asked for.

    Example scenarios:
      - no robot runs on this machine
      - two robots run, and the command or script does not name one
    """


def live_runs() -> list[KnownRun]:
    """Return the runs whose supervisor is alive, oldest first."""
    return [run for run in list_runs() if run.is_live]


def choose_run(run_id: str | None, how: str = "--run ID") -> KnownRun:
    """Return the run with this id, or the only run if it is None.

    Args:
        run_id: the id, or its beginning.
        how: how the user can choose one, for the error.

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
    raise NoSuchRun(f"several runs match: {described}; choose one with {how}")
