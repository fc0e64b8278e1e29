"""`robbie graph`: the modules of a run and the topics between them, as a picture or its source text."""

import argparse
import json
import shutil
import subprocess
import time
from contextlib import closing
from dataclasses import asdict

from robbie_mp.attached.views.run_graph import RunGraph, dot, graph_of, mermaid
from robbie_mp.attached.views.run_graph_svg import svg
from robbie_mp.bus.observe import RunObserver, rates_between
from robbie_mp.cli.amounts import time_between
from robbie_mp.cli.output import warn
from robbie_mp.cli.parser import Commands, add_command
from robbie_mp.cli.runs import add_run_argument, choose_run

MAX_SECONDS = 3600.0
LIMIT_S = 60.0
"""Time that Graphviz may take."""


def add_parser(subparsers: Commands) -> None:
    """Add `graph` to the commands."""
    parser = add_command(
        subparsers,
        "graph",
        "draw modules and topics",
        "Print the modules of a run, and the topics between them with types and rates, as an SVG picture, or "
        "as text from which Mermaid or Graphviz draws one. Where Graphviz is installed, it arranges the SVG. "
        "A dashed line is a subscription by patterns. This costs the robot nothing.",
        ["robbie graph --svg > graph.svg", "robbie graph > graph.mmd", "robbie graph --dot > graph.dot"],
    )
    form = parser.add_mutually_exclusive_group()
    form.add_argument("--mermaid", action="store_true", help="for Mermaid, as in Markdown (the default)")
    form.add_argument("--svg", action="store_true", help="a picture, such as for a browser")
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
        form = _picture if arguments.svg else dot if arguments.dot else mermaid
        print(form(graph), end="")
    return 0


def _picture(graph: RunGraph) -> str:
    """Return the graph as SVG, arranged by Graphviz if it is installed."""
    program = shutil.which("dot")
    if program is None:
        return svg(graph)
    try:
        return subprocess.run(
            [program, "-Tsvg"], input=dot(graph), capture_output=True, text=True, timeout=LIMIT_S, check=True
        ).stdout
    except (OSError, subprocess.SubprocessError) as error:
        warn(f"{program} failed, so the picture is arranged without it: {error}")
        return svg(graph)
