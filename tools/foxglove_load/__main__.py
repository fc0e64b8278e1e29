"""Measures what clients of Foxglove cost the robot: `python -m tools.foxglove_load`.

A camera publishes 20 MB of images in a second, and four pairs of modules exchange 800 small messages. In
each round the tool measures their latency without clients (`without`), with three that read all images
(`three`), and with one that has subscribed and reads nothing (`stopped`). It needs the extra `foxglove`.
"""

import argparse
import json
import sys
from pathlib import Path
from statistics import median

from tools.bench.machine import describe_machine
from tools.bench.table import render, short_number
from tools.foxglove_load.measure import CLIENTS, WITHOUT, Result, measure, robot_with_server

GOAL = 1.2
"""Maximum ratio of a message's p99 latency with clients to that without."""


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
    parser.add_argument("--json", type=Path, metavar="FILE", help="also write the results to this file")
    parsed = parser.parse_args(given)
    results: list[Result] = []
    machine = describe_machine()
    with robot_with_server() as (robot, link):
        for number in range(parsed.rounds):
            for session in CLIENTS:
                results.append(measure(robot, link, session, parsed.seconds) | {"round": number})
    ratios = ratios_to_without(results)
    print(f"{parsed.seconds:g} s, {parsed.rounds} rounds\n\n{as_table(results, ratios)}")
    if parsed.json:
        report = {"machine": machine, "results": results, "ratios": ratios}
        parsed.json.write_text(json.dumps(report, indent=1))
    return 0


def ratios_to_without(results: list[Result]) -> dict[str, dict[str, float]]:
    """Return for each session the ratio of latency to that without clients: the median over all rounds."""
    without = {one["round"]: one for one in results if one["session"] == WITHOUT}
    return {
        session: {
            f"{kind} {quantile}": median(
                one[kind][f"{quantile}_us"] / without[one["round"]][kind][f"{quantile}_us"]
                for one in results
                if one["session"] == session
            )
            for kind in ("small", "image")
            for quantile in ("p50", "p99")
        }
        for session in CLIENTS
        if session != WITHOUT
    }


def as_table(results: list[Result], ratios: dict[str, dict[str, float]]) -> str:
    """Return a table with a row for each session, and the ratios below it."""
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
        lines.append(f"{session} ÷ without (median of rounds; goal {GOAL}): {shown}")
    return "\n".join(lines)


if __name__ == "__main__":
    sys.exit(main())
