"""Runs on this machine: live ones, and what dead ones left."""

from collections.abc import Iterator, Mapping, Sequence
from contextlib import closing

from robbie_mp.bus.observe import RunObserver
from robbie_mp.bus.observe.connections import Unconnected
from robbie_mp.bus.transport.segment import SegmentMismatch, SegmentMissing
from robbie_mp.run.doctor.finding import Finding, ok, warn
from robbie_mp.run.run_directory import list_runs
from robbie_mp.run.supervisor.sweep import dead_runs


def look_at_runs() -> Iterator[Finding]:
    """Judge the runs of this user."""
    runs = list_runs()
    yield check_runs(sum(run.is_live for run in runs), dead_runs())
    for run in runs:
        if run.is_live:
            yield from _look_at_connections(run.run_id)


def check_runs(live: int, dead: Sequence[str]) -> Finding:
    """Judge the number of live runs, and the ids of dead runs that left something."""
    found = f"{live} live" if live else "none is live"
    if dead:
        found += f"; dead ones left something: {', '.join(dead)}"
        return warn("runs", found, "`robbie clean` removes it, and so does the next `robbie run`")
    return ok("runs", found)


def _look_at_connections(run_id: str) -> Iterator[Finding]:
    try:
        observer = RunObserver(run_id)
    except (SegmentMissing, SegmentMismatch):  # it has just ended, or another version of Robbie-MP runs it
        return
    with closing(observer):
        yield check_connections(run_id, observer.unconnected())


def check_connections(run_id: str, alone: Mapping[str, Sequence[Unconnected]]) -> Finding:
    """Judge the subscriptions of a run that nobody publishes for, by module."""
    name = f"connections of {run_id}"
    found = "; ".join(f"{module} {one}" for module, missing in alone.items() for one in missing)
    if not found:
        return ok(name, "every module gets what it needs, or has run for less than 10 s")
    advice = (
        "compare types, versions and topics with `robbie list topics`; rename topics in the profile, or "
        "subscribe with optional=True"
    )
    return warn(name, found, advice)
