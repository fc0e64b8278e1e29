"""Measures Robbie beside its peers: `python -m tools.bench [BENCHMARK…] [--quick] [--json FILE]`."""

import argparse
import json
import signal
import sys
from pathlib import Path
from typing import Any

from tools.bench import latency
from tools.bench.options import Options, read_variant
from tools.bench.table import latency_table

BENCHMARKS = {"latency": latency.run}


def main(arguments: list[str] | None = None) -> int:
    """Run benchmarks and print their tables."""
    parser = argparse.ArgumentParser(prog="python -m tools.bench", description=__doc__)
    names = ", ".join(BENCHMARKS)
    parser.add_argument("benchmarks", nargs="*", metavar="BENCHMARK", help=f"{names}; all if none")
    parser.add_argument("--quick", action="store_true", help="less than 30 s for each")
    parser.add_argument("--json", type=Path, metavar="FILE", help="write the results here as well")
    parser.add_argument("--only", default="", help="names of those measured, as robbie,floor,zeromq")
    parser.add_argument("--rounds", type=int, default=0, help="how often each is measured")
    parser.add_argument("--count", type=int, default=0, help="messages in each round")
    parser.add_argument("--with-top", action="store_true", help="also measure Robbie watched by robbie top")
    parser.add_argument(
        "--variant",
        action="append",
        default=[],
        type=read_variant,
        metavar="NAME=FILE",
        help="also measure Robbie with the keys `core` and `module` of this YAML file",
    )
    parsed = parser.parse_args(arguments)
    unknown = set(parsed.benchmarks) - set(BENCHMARKS)
    if unknown:
        parser.error(f"there is no benchmark {', '.join(sorted(unknown))}")
    options = Options(
        quick=parsed.quick,
        rounds=parsed.rounds,
        count=parsed.count,
        only=tuple(filter(None, parsed.only.split(","))),
        with_top=parsed.with_top,
        variants=dict(parsed.variant),
    )
    results: list[dict[str, Any]] = []
    for name in parsed.benchmarks or BENCHMARKS:
        for result in BENCHMARKS[name](options):
            results.append(result)
            print(f"\n{result['benchmark']}: {result['title']}\n\n{latency_table(result)}", flush=True)
    if parsed.json:
        parsed.json.write_text(json.dumps({"results": results}, indent=2))
    return 0


if __name__ == "__main__":
    signal.signal(signal.SIGTERM, signal.default_int_handler)  # what it started must not outlive it
    sys.exit(main())
