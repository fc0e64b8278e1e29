"""Measures what clients of Foxglove cost the robot: `python -m tools.load.foxglove`.

A camera publishes 20 MB of images in a second, and four pairs of modules exchange 800 small messages. In
each round the tool measures their latency in sessions of a random order: twice without clients (`without`,
`without again`: their ratio shows how much the figures vary by themselves), with three that read all images
(`three`), with three that take only the processor time that the robot leaves, as if they ran on another
machine (`three elsewhere`), and with one that has subscribed and reads nothing (`stopped`). In two further
sessions other processes keep all processors busy, without clients (`busy, without`) and with three (`busy,
three`), one of which presses the emergency stop again and again; the tool takes the times until the base has
stopped. It needs the extra `foxglove`.
"""

import random
from statistics import mean

import numpy as np
import yaml

from tools.bench.machine import describe_machine
from tools.bench.table import render, short_number
from tools.load.command import command_line, run, write
from tools.load.foxglove.comparison import Ratio, compare, quantile_us
from tools.load.foxglove.measure import SESSIONS, Result, measure, robot_with_server

GOAL = 1.2
"""Maximum ratio of a message's p99 latency with clients to that without."""
STOP_GOAL_MS = 100.0
"""Maximum p99 of the time from the press of the emergency stop until the base has stopped."""
KINDS = ("small", "image")
QUANTILES = {"p50": 0.5, "p99": 0.99}


def main(arguments: list[str] | None = None) -> int:
    """Run the command line."""
    parser = command_line("foxglove", __doc__, SESSIONS, seconds=3.0, rounds=12)
    scheduling = "of the server, as in a profile"
    parser.add_argument("--scheduling", type=yaml.safe_load, default={}, metavar="YAML", help=scheduling)
    parsed = parser.parse_args(arguments)
    order = random.Random(0)
    results: list[Result] = []
    machine = describe_machine()
    with robot_with_server(parsed.scheduling) as (robot, link):
        for number in range(parsed.rounds):
            for session in order.sample(parsed.only, len(parsed.only)):
                results.append(measure(robot, link, session, parsed.seconds) | {"round": number})
    ratios, stops = ratios_to_without(results), stop_times(results)
    print(
        f"{parsed.rounds} rounds of {parsed.seconds:g} s, load before: {machine['load_before']}\n\n"
        f"{as_table(results, ratios, stops)}"
    )
    write(parsed.json, machine, results=results, ratios=ratios, stops=stops)
    return 0


def ratios_to_without(results: list[Result]) -> dict[str, dict[str, Ratio]]:
    """Return for each session the ratios of its latencies to those of the session that it is compared to."""
    measured = {one["session"] for one in results}
    return {
        name: {
            f"{kind} {quantile}": compare(
                _rounds(results, name, kind), _rounds(results, session.compared_to, kind), fraction
            )
            for kind in KINDS
            for quantile, fraction in QUANTILES.items()
        }
        for name, session in SESSIONS.items()
        if {name, session.compared_to} <= measured
    }


def _rounds(results: list[Result], name: str, kind: str) -> list[list[int]]:
    """Return the latencies of the messages of a session in each round."""
    return [one[kind] for one in results if one["session"] == name]


def stop_times(results: list[Result]) -> dict[str, float]:
    """Return how long the base took to stop: the median, the p99 and the longest of all rounds, ms."""
    stops_ms = [stop_ms for one in results for stop_ms in one["stops_ms"]]
    if not stops_ms:
        return {}
    p50, p99, longest = np.percentile(stops_ms, (50, 99, 100))
    return {"count": len(stops_ms), "p50_ms": float(p50), "p99_ms": float(p99), "max_ms": float(longest)}


def as_table(results: list[Result], ratios: dict[str, dict[str, Ratio]], stops: dict[str, float]) -> str:
    """Return a table with a row for each session, and below it the ratios and the times to stop."""
    figures = [f"{kind} {quantile}" for kind in KINDS for quantile in QUANTILES]
    rows = []
    for name in SESSIONS:
        own = [one for one in results if one["session"] == name]
        if not own:
            continue
        latencies = [
            quantile_us(_rounds(own, name, kind), fraction)
            for kind in KINDS
            for fraction in QUANTILES.values()
        ]
        shares = [mean(one[share] for one in own) for share in ("server_percent", "machine_percent")]
        read = np.mean([one["client_mb_per_s"] for one in own], axis=0)
        rows.append([name, *map(short_number, [*latencies, *shares]), " ".join(f"{one:.1f}" for one in read)])
    headings = ["session", *(f"{one} us" for one in figures), "server %", "machine %", "MB/s of each client"]
    ratio_rows = [
        [f"{name} ÷ {SESSIONS[name].compared_to}", *(_as_text(found[one]) for one in figures)]
        for name, found in ratios.items()
    ]
    lines = [render(headings, rows), "", render([f"goal: p99 at most {GOAL}", *figures], ratio_rows)]
    if stops:
        lines.append(
            f"\nbusy, {stops['count']:.0f} emergency stops (goal p99 {STOP_GOAL_MS:g} ms): median "
            f"{stops['p50_ms']:.1f} ms, p99 {stops['p99_ms']:.1f} ms, longest {stops['max_ms']:.1f} ms"
        )
    return "\n".join(lines)


def _as_text(ratio: Ratio) -> str:
    return f"{ratio.value:.2f} ({ratio.low:.2f} to {ratio.high:.2f})"


if __name__ == "__main__":
    run(main)
