"""`robbie graph`: the modules of a run and the topics between them, as a picture's source text."""

import argparse
import json
import time
from contextlib import closing
from dataclasses import asdict
from typing import TYPE_CHECKING

from robbie_mp.attached.views.run_graph import dot, graph_of, mermaid
from robbie_mp.bus.observe import RunObserver, rates_between
from robbie_mp.cli.amounts import time_between
from robbie_mp.cli.parser import add_command
from robbie_mp.cli.runs import add_run_argument, choose_run

if TYPE_CHECKING:
    from argparse import _SubParsersAction

MAX_SECONDS = 3600.0


def add_parser(subparsers: "_SubParsersAction[argparse.ArgumentParser]") -> None:
    """Add `graph` to the commands."""
    parser = add_command(
        subparsers,
        "graph",
        "draw modules and topics",
        "Print the modules of a run, and the topics between them with types and rates, as text from which "
        "Mermaid or Graphviz draws a picture. A dashed line is a subscription by patterns. This costs the "
        "robot nothing.",
        ["robbie graph > graph.mmd", "robbie graph --dot | dot -Tsvg > graph.svg"],
    )
    form = parser.add_mutually_exclusive_group()
    form.add_argument("--mermaid", action="store_true", help="for Mermaid, as in Markdown (the default)")
    form.add_argument("--dot", action="store_true", help="for Graphviz")
    form.add_argument("--json", action="store_true", help="print JSON for a program to read")
    parser.add_argument(
        "--interval",
        metavar="TIME",
        type=time_between(0, MAX_SECONDS),
        default=1.0,
        help="time over which rates are measured (1s); 0: no rates",
    )
    parser.add_argument("--no-patterns", action="store_true", help="leave out subscriptions by patterns")
    add_run_argument(parser)
    parser.set_defaults(command=draw)


def draw(arguments: argparse.Namespace) -> int:
    """Print the graph."""
    with closing(RunObserver(choose_run(arguments.run).run_id)) as observer:
        before = now = observer.read()
        if arguments.interval:
            time.sleep(arguments.interval)
            now = observer.read()
    rates = rates_between(before, now) if arguments.interval else None
    graph = graph_of(now, rates, patterns=not arguments.no_patterns)
    if arguments.json:
        print(json.dumps(asdict(graph), indent=2))
    else:
        print(dot(graph) if arguments.dot else mermaid(graph), end="")
    return 0
