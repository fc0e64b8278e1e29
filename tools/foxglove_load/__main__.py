"""Measures what clients of Foxglove cost the robot: `python -m tools.foxglove_load`.

A camera publishes 20 MB of images in a second, and four pairs of modules exchange 800 small messages. In
each round the tool measures their latency without clients (`without`), with three that read all images
(`three`), and with one that has subscribed and reads nothing (`stopped`). Then other processes keep all
processors busy, without clients (`busy, without`) and with three (`busy, three`), one of which presses the
emergency stop again and again; the tool takes the times until the base has stopped. It needs the extra
`foxglove`.
"""

import argparse
import json
import sys
from pathlib import Path
from statistics import median

import numpy as np
import yaml

from tools.bench.machine import describe_machine
from tools.bench.table import render, short_number
from tools.foxglove_load.measure import SESSIONS, Result, measure, robot_with_server

GOAL = 1.2
"""Maximum ratio of a message's p99 latency with clients to that without."""
STOP_GOAL_MS = 100.0
"""Maximum p99 of the time from the press of the emergency stop until the base has stopped."""


def main(arguments: list[str] | None = None) -> int:
    """Run the command line."""
    given = sys.argv[1:] if arguments is None else arguments
    parser = argparse.ArgumentParser(
        prog="python -m tools.foxglove_load",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("--seconds", type=float, default=10.0, help="duration of each session")
    parser.add_argument("--rounds", type=int, default=3, help="number of rounds")
    parser.add_argument(
        "--scheduling", type=yaml.safe_load, default={}, metavar="YAML", help="of the server, as in a profile"
    )
    parser.add_argument("--json", type=Path, metavar="FILE", help="also write the results to this file")
    parsed = parser.parse_args(given)
    results: list[Result] = []
    machine = describe_machine()
    with robot_with_server(parsed.scheduling) as (robot, link):
        for number in range(parsed.rounds):
            for session in SESSIONS:
                results.append(measure(robot, link, session, parsed.seconds) | {"round": number})
    ratios = ratios_to_without(results)
    stops = stop_times(results)
    print(f"{parsed.seconds:g} s, {parsed.rounds} rounds\n\n{as_table(results, ratios, stops)}")
    if parsed.json:
        report = {"machine": machine, "results": results, "ratios": ratios, "stops": stops}
        parsed.json.write_text(json.dumps(report, indent=1))
    return 0


def ratios_to_without(results: list[Result]) -> dict[str, dict[str, float]]:
    """Return for each session the ratio of latency to that without clients: the median over all rounds."""
    found = {(one["session"], one["round"]): one for one in results}
    return {
        name: {
            f"{kind} {quantile}": median(
                one[kind][f"{quantile}_us"] / found[session.compared_to, one["round"]][kind][f"{quantile}_us"]
                for one in results
                if one["session"] == name
            )
            for kind in ("small", "image")
            for quantile in ("p50", "p99")
        }
        for name, session in SESSIONS.items()
        if session.compared_to and any(one["session"] == name for one in results)
    }


def stop_times(results: list[Result]) -> dict[str, float]:
    """Return how long the base took to stop: the median, the p99 and the longest of all rounds, ms."""
    stops_ms = [stop_ms for one in results for stop_ms in one["stops_ms"]]
    if not stops_ms:
        return {}
    p50, p99, longest = np.percentile(stops_ms, (50, 99, 100))
    return {"count": len(stops_ms), "p50_ms": float(p50), "p99_ms": float(p99), "max_ms": float(longest)}


def as_table(results: list[Result], ratios: dict[str, dict[str, float]], stops: dict[str, float]) -> str:
    """Return a table with a row for each session, and below it the ratios and the times to stop."""
    kinds = [(kind, quantile) for kind in ("small", "image") for quantile in ("p50", "p99")]
    headings = ["session", *(f"{kind} {quantile} us" for kind, quantile in kinds)]
    rows = [
        [
            one["session"],
            *(short_number(one[kind][f"{quantile}_us"]) for kind, quantile in kinds),
            short_number(one["server_percent"]),
            short_number(one["machine_percent"]),
            " ".join(f"{rate:.1f}" for rate in one["client_mb_per_s"]),
        ]
        for one in results
    ]
    lines = [render([*headings, "server %", "machine %", "MB/s of each client"], rows), ""]
    for session, found in ratios.items():
        shown = ", ".join(
            f"{kind} {value:.2f}{'' if value <= GOAL else ' !'}" for kind, value in found.items()
        )
        without = SESSIONS[session].compared_to
        lines.append(f"{session} ÷ {without} (median of rounds; goal {GOAL}): {shown}")
    if stops:
        lines.append(
            f"busy, {stops['count']:.0f} emergency stops (goal p99 {STOP_GOAL_MS:g} ms): median "
            f"{stops['p50_ms']:.1f} ms, p99 {stops['p99_ms']:.1f} ms, longest {stops['max_ms']:.1f} ms"
        )
    return "\n".join(lines)


if __name__ == "__main__":
    sys.exit(main())
