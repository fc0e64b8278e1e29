"""Measures what recording everything costs: `python -m tools.load [--seconds 60] [--json FILE]`.

Twenty modules exchange images of 6.2 MB ten times a second and 2,000 small messages a second. In each round
the tool measures them in turn without a recorder (`without`), with a subscriber that takes everything and
does nothing (`taker`), and with the logger (`logger`).
"""

import argparse
import json
import signal
import sys
from collections.abc import Callable
from pathlib import Path
from statistics import median

from tools.bench.machine import describe_machine
from tools.bench.table import render, short_number
from tools.load.measure import CLASSES, WITHOUT, Result, measure

GOAL = 1.2
"""Maximum ratio of a message's latency with a logger to that without."""
COLUMNS: dict[str, Callable[[Result], float | None]] = {
    "small p50 us": lambda one: one["small"]["p50_us"],
    "small p99 us": lambda one: one["small"]["p99_us"],
    "image p50 us": lambda one: one["image"]["p50_us"],
    "image p99 us": lambda one: one["image"]["p99_us"],
    "recorder %": lambda one: one.get("recorder_percent"),
    "core %": lambda one: one["core_percent"],
    "machine %": lambda one: one["machine_percent"],
    "disk MB/s": lambda one: one.get("disk_mb_per_s"),
    "dropped": lambda one: one.get("dropped"),
    "dropped in log": lambda one: one.get("log_dropped"),
    "log MB": lambda one: one.get("log_mb"),
}


def main(arguments: list[str] | None = None) -> int:
    """Run the command line."""
    parser = argparse.ArgumentParser(
        prog="python -m tools.load",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    add = parser.add_argument
    add("--seconds", type=float, default=60.0, help="duration of each session (60)")
    add("--rounds", type=int, default=1, help="number of rounds (1)")
    add("--json", type=Path, metavar="FILE", help="also write the results to this file")
    parsed = parser.parse_args(arguments)
    results: list[Result] = []
    report = {"machine": describe_machine(), "command": " ".join(sys.argv), "results": results}
    for round_number in range(parsed.rounds):
        for recorder in (WITHOUT, *CLASSES):
            results.append(measure(recorder, parsed.seconds) | {"round": round_number})
            print(json.dumps(results[-1]), file=sys.stderr, flush=True)
    print(as_table(results, ratios_to_without(results)))
    if parsed.json:
        parsed.json.write_text(json.dumps(report, indent=1))
    return 0


def ratios_to_without(results: list[Result]) -> dict[str, dict[str, float]]:
    """Return for each recorder the ratio of latency with it to that without: the median over all rounds."""
    without = {one["round"]: one for one in results if one["recorder"] == WITHOUT}
    found: dict[str, dict[str, float]] = {}
    for recorder in CLASSES:
        those = [one for one in results if one["recorder"] == recorder and one["round"] in without]
        pairs = [(one, without[one["round"]]) for one in those]
        if pairs:
            found[recorder] = {
                f"{kind} {quantile}": median(
                    one[kind][f"{quantile}_us"] / other[kind][f"{quantile}_us"] for one, other in pairs
                )
                for kind in ("small", "image")
                for quantile in ("p50", "p99")
            }
    return found


def as_table(results: list[Result], ratios: dict[str, dict[str, float]]) -> str:
    """Return a table with a row for each session, and the ratios below it."""
    rows = [[one["recorder"], *(short_number(read(one)) for read in COLUMNS.values())] for one in results]
    lines = [render(["recorder", *COLUMNS], rows), ""]
    for recorder, kinds in ratios.items():
        shown = ", ".join(
            f"{kind} {value:.2f}{'' if value <= GOAL else ' !'}" for kind, value in kinds.items()
        )
        lines.append(f"{recorder} ÷ without (median of rounds; goal {GOAL}): {shown}")
    return "\n".join(lines)


if __name__ == "__main__":
    signal.signal(signal.SIGTERM, signal.default_int_handler)  # the robot must not outlive this program
    sys.exit(main())
