"""Measures what the operator's page costs: `python -m tools.load.operator [--seconds 60] [--json FILE]`.

An operator and five observers watch a robot with a map of 1000 x 1000 cells, two cameras at 10 Hz and 50,000
points at 5 Hz. The robot's modules also exchange 500 small messages a second. The tool measures the latency
of messages without a station, with a station without pages, with pages, and with one more observer whose link
carries little or no data. Then it measures how often the map and the 3-D view are drawn while a mouse drags
and zooms there. The session `tiles` is one operator with a layout of six live things, and `hidden` the
same after another panel has taken their place; `parameters` is a page that has shown only that panel. In
`tiles-elsewhere` and `hidden-elsewhere`, the browser takes only the processor time that the robot leaves, as
if it ran on another machine.
"""

import argparse
import json
import sys

from tools.bench.machine import describe_machine
from tools.bench.table import render, short_number
from tools.load.command import command_line, run, write
from tools.load.operator import HIDDEN, TILES
from tools.load.operator.measure import KINDS, Result, Session, measure, own_mb, updates_hz

TABS = ("view", "map", "cameras", "view", "map", "cameras")
SLOW_BYTES_PER_S = 20_000.0
HEADINGS = (
    "session", "view/s", "map/s", "images/s", "station %", "pages %", "machine %", "MB at begin", "MB at end",
    "connections", "small p50 us", "small p99 us", "image p50 us", "image p99 us",
)  # fmt: skip


def main(arguments: list[str] | None = None) -> int:
    """Run the command line."""
    parsed = _parser().parse_args(arguments)
    sessions = sessions_of(parsed.kind, tuple(parsed.tabs.split(",")))
    machine = describe_machine()
    results: list[Result] = []
    for _ in range(parsed.rounds):
        for name in parsed.only:
            results.append(measure(sessions[name], parsed.seconds, parsed.cells, parsed.points))
            print(json.dumps(results[-1]), file=sys.stderr, flush=True)
    print(f"\n{machine['date']}, {parsed.kind} pages: {parsed.tabs}; {parsed.seconds:g} s each\n")
    print(render(list(HEADINGS), [row(result) for result in results]))
    for result in results:
        for page in result.get("pages", ()):
            if page["tab"] in (TILES, HIDDEN):
                print(f"{result['session']}: updates a second: {page}")
        for dragged in result.get("dragged", ()):
            page, scene = dragged["page"], dragged["scene"]
            print(f"{result['session']}: drawn {page:.1f} times a second, the scene {scene:.1f} times")
    write(parsed.json, machine, results=results)
    return 0


def sessions_of(kind: str, tabs: tuple[str, ...]) -> dict[str, Session]:
    """Return all sessions by name."""
    found = (
        Session("without", has_station=False),
        Session("idle"),
        Session("pages", kind=kind, tabs=tabs),
        Session("stopped", kind=kind, tabs=tabs, slow_bytes_per_s=0.0),
        Session("slow", kind=kind, tabs=tabs, slow_bytes_per_s=SLOW_BYTES_PER_S),
        Session("tiles", kind="browser", tabs=(TILES,)),
        Session("hidden", kind="browser", tabs=(HIDDEN,)),
        Session("parameters", kind="browser", tabs=("parameters",)),
        Session("tiles-elsewhere", kind="elsewhere", tabs=(TILES,)),
        Session("hidden-elsewhere", kind="elsewhere", tabs=(HIDDEN,)),
        Session("drag-map", kind="browser", tabs=("map",), is_dragged=True),
        Session("drag-view", kind="browser", tabs=("view",), is_dragged=True),
    )
    return {session.name: session for session in found}


def row(result: Result) -> list[str]:
    """Return the table row of a session. Of pages with the same tab, it has the slowest one."""
    rates = [min(updates_hz(result, tab), default=None) for tab in ("view", "map", "cameras")]
    memory = own_mb(result) or (None, None)
    connections = result["memory"][-1]["connections"] if result["memory"] else None
    latencies = [result[kind][quantile] for kind in ("small", "image") for quantile in ("p50_us", "p99_us")]
    shares = [result.get("station_percent"), result.get("pages_percent"), result["machine_percent"]]
    return [result["session"], *map(short_number, [*rates, *shares, *memory, connections, *latencies])]


def _parser() -> argparse.ArgumentParser:
    parser = command_line("operator", __doc__, sessions_of("light", ()))
    kind = "pages in Chromium, in one that takes only what the robot leaves, or that draw nothing"
    parser.add_argument("--kind", choices=KINDS, default="browser", help=kind)
    tabs = "tab of each page; the first page is the operator's, the others are observers'"
    parser.add_argument("--tabs", default=",".join(TABS), help=tabs)
    parser.add_argument("--cells", type=int, default=1000, help="cells along each edge of the map")
    parser.add_argument("--points", type=int, default=50_000, help="points in each cloud")
    return parser


if __name__ == "__main__":
    run(main)
