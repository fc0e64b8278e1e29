"""Measures what recording everything costs: `python -m tools.load.logger [--seconds 60] [--json FILE]`.

Twenty modules exchange images of 6.2 MB ten times a second and 2,000 small messages a second. In each round
the tool measures them in turn without a recorder (`without`) and with each of these:
  taker      a subscriber that takes everything and does nothing,
  patient    the same, but it takes messages only every 20 ms, as the logger does,
  bystander  a process that takes no messages, but compresses as much data as the logger,
  discard    a logger that copies every message and discards it,
  null       a logger that also compresses, and writes to /dev/null,
  memory     the logger, writing into /dev/shm,
  logger     the logger, writing to the disk.
"""

import json
import sys
from collections.abc import Callable
from statistics import median
from typing import Any

import yaml

from tools.bench.machine import describe_machine
from tools.bench.table import render, short_number
from tools.load.command import command_line, run, write
from tools.load.logger.measure import CLASSES, WITHOUT, Result, measure

GOAL = 1.2
"""Maximum ratio of a message's latency with a logger to that without."""
COLUMNS: dict[str, Callable[[Result], float | None]] = {
    "small p50 us": lambda one: one["small"]["p50_us"],
    "small p99 us": lambda one: one["small"]["p99_us"],
    "image p50 us": lambda one: one["image"]["p50_us"],
    "image p99 us": lambda one: one["image"]["p99_us"],
    "logger %": lambda one: one.get("logger_percent"),
    "core %": lambda one: one["core_percent"],
    "machine %": lambda one: one["machine_percent"],
    "disk MB/s": lambda one: one.get("disk_mb_per_s"),
    "most waited": lambda one: one.get("waiting_peak"),
    "dropped": lambda one: one["core_dropped"] + one["core_lost"] if "core_dropped" in one else None,
    "left at end": lambda one: one.get("core_left"),
    "dropped in log": lambda one: one.get("log_dropped"),
    "log MB": lambda one: one.get("log_mb"),
}


def main(arguments: list[str] | None = None) -> int:
    """Run the command line."""
    parser = command_line("logger", __doc__, [WITHOUT, *CLASSES])
    setting = "setting of the logger"
    parser.add_argument(
        "--set", type=_setting, action="append", default=[], metavar="KEY=VALUE", help=setting
    )
    parsed = parser.parse_args(arguments)
    results: list[Result] = []
    machine = describe_machine()
    for round_number in range(parsed.rounds):
        for recorder in parsed.only:
            results.append(measure(recorder, dict(parsed.set), parsed.seconds) | {"round": round_number})
            print(json.dumps(results[-1]), file=sys.stderr, flush=True)
    ratios = ratios_to_without(results)
    print(f"\n{parsed.seconds:g} s, {parsed.rounds} rounds\n\n{as_table(results, ratios)}")
    write(parsed.json, machine, results=results, ratios=ratios)
    return 0


def _setting(text: str) -> tuple[str, Any]:
    key, _, value = text.partition("=")
    return key, yaml.safe_load(value)


def ratios_to_without(results: list[Result]) -> dict[str, dict[str, float]]:
    """Return for each recorder the ratio of latency with it to that without: the median over all rounds."""
    without = {one["round"]: one for one in results if one["recorder"] == WITHOUT}
    found: dict[str, dict[str, float]] = {}
    for recorder in CLASSES:
        pairs = [
            (one, without[one["round"]])
            for one in results
            if one["recorder"] == recorder and one["round"] in without
        ]
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
    run(main)
