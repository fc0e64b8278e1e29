"""Runs on this machine: live ones, and what dead ones left."""

from collections.abc import Iterator, Sequence

from robbie_mp.doctor.finding import Finding, ok, warn
from robbie_mp.run.run_directory import list_runs
from robbie_mp.supervisor.sweep import unclaimed_runs


def look_at_runs() -> Iterator[Finding]:
    """Judge the runs of this user."""
    runs = list_runs()
    dead = [run.run_id for run in runs if not run.is_live] + unclaimed_runs()
    yield check_runs(len(runs) - sum(not run.is_live for run in runs), dead)


def check_runs(live: int, dead: Sequence[str]) -> Finding:
    """Judge the number of live runs, and the ids of dead runs that left something."""
    found = f"{live} live" if live else "none is live"
    if dead:
        found += f"; dead ones left something: {', '.join(dead)}"
        return warn("runs", found, "`robbie clean` removes it, and so does the next `robbie run`")
    return ok("runs", found)
