"""`robbie list`: the runs of this machine."""

import argparse
import json
from dataclasses import asdict
from typing import TYPE_CHECKING

from rich.table import Table

from robbie_mp.cli.figures import console, state_name
from robbie_mp.cli.runs import live_runs
from robbie_mp.observe import RunObserver
from robbie_mp.supervisor.run_directory import KnownRun
from robbie_mp.transport.segment import SegmentMissing

if TYPE_CHECKING:
    from argparse import _SubParsersAction


def add_parser(subparsers: "_SubParsersAction[argparse.ArgumentParser]") -> None:
    """Add `list` to the commands."""
    parser = subparsers.add_parser("list", help="list the runs of this machine and their modules")
    parser.add_argument("--json", action="store_true", help="print JSON for a program to read")
    parser.set_defaults(command=list_all)


def list_all(arguments: argparse.Namespace) -> int:
    """Print all live runs."""
    runs = [(run, _modules(run)) for run in live_runs()]
    if arguments.json:
        print(json.dumps([_as_data(run, modules) for run, modules in runs], indent=2))
        return 0
    if not runs:
        print("no run on this machine; start one with `robbie run PROFILE`")
        return 0
    table = Table("run", "profile", "supervisor", "since (UTC)", "modules", box=None, pad_edge=False)
    for run, modules in runs:
        record = run.record
        states = ", ".join(f"{name} {state}" for name, state in modules.items()) or "starting"
        if record is not None:
            since = record.started_at[:19].replace("T", " ")
            table.add_row(run.run_id, record.profile, str(record.supervisor_pid), since, states)
    console().print(table)
    return 0


def _modules(run: KnownRun) -> dict[str, str]:
    """State by name; empty while the run has not made its memory yet, or no longer."""
    try:
        observer = RunObserver(run.run_id)
    except SegmentMissing:
        return {}
    states = {module.name: state_name(module) for module in observer.modules()[1:]}
    observer.close()
    return states


def _as_data(run: KnownRun, modules: dict[str, str]) -> dict[str, object]:
    return {**(asdict(run.record) if run.record else {"run_id": run.run_id}), "modules": modules}
