"""`robbie top --once`: what every module of a run is doing, as it is now."""

import argparse
import json
from contextlib import closing
from dataclasses import asdict
from typing import TYPE_CHECKING

from robbie_mp.cli.figures import as_data, console, table
from robbie_mp.cli.runs import add_run_argument, choose_run
from robbie_mp.observe import RunObserver

if TYPE_CHECKING:
    from argparse import _SubParsersAction


def add_parser(subparsers: "_SubParsersAction[argparse.ArgumentParser]") -> None:
    """Add `top` to the commands."""
    parser = subparsers.add_parser("top", help="show what every module of a run is doing")
    parser.add_argument("--once", action="store_true", required=True, help="print the figures and end")
    parser.add_argument("--json", action="store_true", help="print JSON for a program to read")
    add_run_argument(parser)
    parser.set_defaults(command=show_once)


def show_once(arguments: argparse.Namespace) -> int:
    """Print a run's figures once."""
    run = choose_run(arguments.run)
    with closing(RunObserver(run.run_id)) as observer:
        modules = observer.modules()
        if arguments.json:
            data = {
                "run_id": run.run_id,
                "profile": run.record.profile if run.record else "",
                "routed": observer.routed,
                "modules": [as_data(module) for module in modules],
                "channels": [asdict(channel) for channel in observer.channels()],
            }
            print(json.dumps(data, indent=2))
        else:
            console().print(table(modules, live=True))
    return 0
