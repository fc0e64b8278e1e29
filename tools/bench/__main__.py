"""Compares Robbie with other transports: `python -m tools.bench [BENCHMARK…] [--quick] [--json FILE]`."""

import argparse
import json
import signal
import sys
from pathlib import Path
from typing import Any

from tools.bench import load, messages
from tools.bench.calling import call
from tools.bench.goals import goal_table
from tools.bench.machine import describe_machine
from tools.bench.options import Options, read_variant
from tools.bench.pipeline import pipeline
from tools.bench.report import described, write_report
from tools.bench.restart import restart
from tools.bench.standard import standard
from tools.bench.standard_table import standard_table
from tools.bench.table import table

BENCHMARKS = {
    "latency": messages.latency,
    "large": messages.large,
    "fanout": messages.fanout,
    "throughput": messages.throughput,
    "idle": load.idle,
    "loaded": load.loaded,
    "restart": restart,
    "call": call,
    "relay": messages.relay,
    "pipeline": pipeline,
}


def main(arguments: list[str] | None = None) -> int:
    """Run the command line."""
    given = sys.argv[1:] if arguments is None else arguments
    parser = _parser()
    parsed = parser.parse_args(given)
    unknown = set(parsed.benchmarks) - set(BENCHMARKS)
    if parsed.standard and parsed.benchmarks:
        parser.error(f"--standard measures all it needs; leave out {', '.join(parsed.benchmarks)}")
    if unknown:
        parser.error(f"there is no benchmark {', '.join(sorted(unknown))}; there are {', '.join(BENCHMARKS)}")
    if parsed.read:
        run = json.loads(parsed.read.read_text())
    else:
        machine = describe_machine()
        command = " ".join(["python -m tools.bench", *given])
        run = {"machine": machine, "command": command, "standard": parsed.standard}
        run["results"] = _measure(parsed, _options(parsed))
    if run.get("standard"):
        print(f"\n{described(run)}\n\n{standard_table(run['results'])}")
    if parsed.json:
        parsed.json.write_text(json.dumps(run, indent=1))
    if parsed.report:
        write_report(run, parsed.report)
    return 0


def _measure(parsed: argparse.Namespace, options: Options) -> list[dict[str, Any]]:
    """Run benchmarks, and print the table of each when it is done; the standard ones have one table."""
    if parsed.standard:
        return standard(options)
    results: list[dict[str, Any]] = []
    for name in parsed.benchmarks or BENCHMARKS:
        for result in BENCHMARKS[name](options):
            results.append(result)
            print(f"\n{result['benchmark']}: {result['title']}\n\n{table(result)}", flush=True)
    if goals := goal_table(results):
        print(f"\ngoals\n\n{goals}")
    return results


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="python -m tools.bench", description=__doc__)
    add = parser.add_argument
    add("benchmarks", nargs="*", metavar="BENCHMARK", help=f"{', '.join(BENCHMARKS)}; default: all")
    add(
        "--standard",
        action="store_true",
        help="one table beside all installed peers, in 20 minutes",
    )
    add("--quick", action="store_true", help="take less than 30 s for each benchmark")
    add("--json", type=Path, metavar="FILE", help="also write the results to this file")
    add(
        "--report", type=Path, metavar="DOCS", help="also write the results into benchmarks.md in this folder"
    )
    add(
        "--read",
        type=Path,
        metavar="FILE",
        help="measure nothing; use the results in this file, which --json wrote",
    )
    add("--only", default="", help="measure only these contenders, for example robbie,floor,zeromq")
    add("--rounds", type=int, default=0, help="number of rounds")
    add("--count", type=int, default=0, help="number of messages in each round")
    add("--modules", type=int, default=0, help="maximum number of modules or subscribers")
    add("--seconds", type=float, default=0.0, help="time for which processor time is measured")
    add(
        "--variant",
        action="append",
        default=[],
        type=read_variant,
        metavar="NAME=FILE",
        help="also measure Robbie with the keys `core`, `module` and `black_box` of this YAML file",
    )
    return parser


def _options(parsed: argparse.Namespace) -> Options:
    return Options(
        quick=parsed.quick,
        rounds=parsed.rounds,
        count=parsed.count,
        modules=parsed.modules,
        seconds=parsed.seconds,
        only=tuple(filter(None, parsed.only.split(","))),
        variants=dict(parsed.variant),
    )


if __name__ == "__main__":
    signal.signal(
        signal.SIGTERM, signal.default_int_handler
    )  # the processes that it started must not outlive it
    try:
        sys.exit(main())
    except KeyboardInterrupt:
        sys.exit(130)
