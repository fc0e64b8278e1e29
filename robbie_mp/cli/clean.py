"""`robbie clean`: remove the remains of dead runs, and old results."""

import argparse
import json
import time
from collections.abc import Iterable
from dataclasses import asdict
from pathlib import Path

from robbie_mp.attached.views import quantities
from robbie_mp.base.linux.fastdds_memory import remove_dead_participants
from robbie_mp.cli.amounts import time_between
from robbie_mp.cli.output import say
from robbie_mp.cli.parser import Commands, add_command
from robbie_mp.logs.black_box.power_loss import recover
from robbie_mp.logs.black_box.salvage import salvage
from robbie_mp.run.results import RunResults, results_below
from robbie_mp.run.supervisor.sweep import Swept, sweep

OUTPUT = Path("output")
CENTURY_S = 3.2e9


def add_parser(subparsers: Commands) -> None:
    """Add `clean` to the commands."""
    parser = add_command(
        subparsers,
        "clean",
        "remove the remains of dead runs, and old results",
        "Remove the shared memory, processes and folders of runs whose supervisor is dead. Each `robbie run` "
        "does this first. Live runs are not touched. With --older-than, also remove results of runs, with "
        "the recordings in them; a folder that you have renamed stays.",
        [
            "robbie clean",
            "robbie clean --json",
            "robbie clean --older-than 30d --dry-run",
            "robbie clean --older-than 14d output/demo",
        ],
    )
    # At least a minute: a number whose unit was forgotten is in seconds.
    age = time_between(60.0, CENTURY_S)
    parser.add_argument(
        "--older-than", type=age, metavar="AGE", help="remove results older than, such as, 30d"
    )
    parser.add_argument("--dry-run", action="store_true", help="only list these results")
    parser.add_argument(
        "folder", type=Path, nargs="?", default=OUTPUT, help="folder with the results (output)"
    )
    parser.add_argument("--json", action="store_true", help="print JSON for a program to read")
    parser.set_defaults(command=clean, usage_error=parser.error)


def sweep_dead_runs() -> Swept:
    """Remove what dead runs and killed nodes left, after the runs' last messages have become clips."""
    told: list[str] = []
    swept = sweep(salvage=lambda run_id, folder: told.extend(salvage(run_id, folder)))
    for line in told:
        say(line)
    if nodes := remove_dead_participants():
        say(f"removed {len(nodes)} files in shared memory of ROS 2 nodes that had been killed (FastDDS)")
    return swept


def recover_power_losses(spools: Iterable[Path]) -> None:
    """Make clips of what power cuts have left."""
    for line in recover(spools):
        say(line)


def clean(arguments: argparse.Namespace) -> int:
    """Remove the remains, and print what was removed."""
    age_s, is_dry_run = arguments.older_than, arguments.dry_run
    if age_s is None and (is_dry_run or arguments.folder != OUTPUT):
        arguments.usage_error("name the age of results to remove, such as --older-than 30d")
    swept = Swept() if is_dry_run else sweep_dead_runs()
    old = (
        []
        if age_s is None
        else [one for one in results_below(arguments.folder) if one.changed_s < time.time() - age_s]
    )
    for one in [] if is_dry_run else old:
        one.remove()
    if arguments.json:
        print(json.dumps(asdict(swept) | {"results": [str(one.folder) for one in old]}, indent=2))
        return 0
    if not is_dry_run:
        print(
            f"removed {len(swept.runs)} dead runs, {len(swept.names)} names in shared memory, "
            f"{len(swept.processes)} processes"
        )
    if age_s is not None:
        _print_results(old, is_dry_run)
    return 0


def _print_results(old: list[RunResults], is_dry_run: bool) -> None:
    for one in old:
        left = "  could not be removed completely" * (not is_dry_run and one.folder.exists())
        print(f"{one.folder}  {quantities.size(one.bytes)}{'  with a recording' * one.has_recording}{left}")
    size = quantities.size(sum(one.bytes for one in old))
    print(f"{'would remove' if is_dry_run else 'removed'} {len(old)} results, {size}")
