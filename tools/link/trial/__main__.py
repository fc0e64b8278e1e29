"""Measures what a link keeps of its promises over a bad network. Needs root.

    python -m tools.link.trial --seconds 20 --cuts 50 --json FILE

Two robots run on two hosts of a test network. All the time, bulk messages fill the link, and the laptop
drives the robot. The exit code is 1 if a promise was broken.
"""

import argparse
import json
import sys
import tempfile
from dataclasses import asdict
from pathlib import Path

from tools.bench.machine import describe_machine
from tools.link.trial.conditions import TRIALS, Figures, Trial, cut_while_driving, operate, run_trial
from tools.link.trial.pair import linked_pair, operated_pair
from tools.test_network.network import Network, NoTestNetwork

MAX_STOP_S = 0.4
HEADING = (
    "| network | commands: received | p50, p99, max ms | urgent: max ms | state: greatest age ms "
    "| reliable: p99 ms, missing | bulk Mbit/s | broken |"
)


def row(figures: Figures) -> str:
    """Return a row of the table."""
    one = figures
    return (
        f"| {one.title} | {one.commands_received:.1%} | {one.command_p50:.0f}, {one.command_p99:.0f}, "
        f"{one.command_max:.0f} | {one.urgent_max:.0f} | {one.state_age_max:.0f} | {one.reliable_p99:.0f}, "
        f"{one.reliable_missing} | {one.bulk_mbit_per_s:.1f} | {'; '.join(one.failures) or '-'} |"
    )


def main() -> int:
    """Run the command line."""
    parser = argparse.ArgumentParser(prog="python -m tools.link.trial", description=__doc__)
    parser.add_argument("--seconds", type=float, default=20.0, help="length of each measurement (20)")
    parser.add_argument("--only", metavar="WORD", help="only conditions whose title has this word")
    parser.add_argument("--cuts", type=int, default=50, help="number of cuts while driving (50)")
    parser.add_argument("--seed", type=int, default=0, help="of the moments of the cuts (0)")
    parser.add_argument("--operator", action="store_true", help="measure only what an operator has")
    parser.add_argument("--json", type=Path, metavar="FILE", help="write the figures to this file")
    options = parser.parse_args()
    trials = [one for one in TRIALS if options.only is None or options.only in one.title]
    try:
        with (
            Network("robot", "laptop") as network,
            tempfile.TemporaryDirectory(prefix="robbie-link-") as folder,
        ):
            if options.operator:
                with operated_pair(Path(folder), network) as pair:
                    print(operate(pair, options.seconds))
                return 0
            return _run(network, Path(folder), trials, options)
    except NoTestNetwork as error:
        print(f"not measured: {error}", file=sys.stderr)
        return 2


def _run(network: Network, folder: Path, trials: list[Trial], options: argparse.Namespace) -> int:
    with linked_pair(folder, network) as pair:
        print(HEADING)
        print("|---" * HEADING.count(" | ") + "|---|")
        found = []
        for trial in trials:
            found.append(run_trial(pair, trial, options.seconds))
            print(row(found[-1]), flush=True)
        stops = cut_while_driving(pair, options.cuts, options.seed) if options.cuts else None
    is_broken = any(one.failures for one in found)
    if stops is not None:
        good = sum(one <= MAX_STOP_S for one in stops.times_s)
        is_broken |= good < options.cuts or stops.by_itself > 0
        print(
            f"cut while driving: the base stands within {MAX_STOP_S} s in {good} of {options.cuts}, at the "
            f"latest after {max(stops.times_s):.3f} s; the oldest command obeyed was "
            f"{stops.oldest_s * 1e3:.0f} ms old; {stops.by_itself} commands were obeyed after the link had "
            "returned, although the operator had let go"
        )
    if options.json:
        report = {"machine": describe_machine(), "conditions": [asdict(one) for one in found],
                  "stops": asdict(stops) if stops else None}  # fmt: skip
        options.json.write_text(json.dumps(report, indent=2))
    return int(is_broken)


if __name__ == "__main__":
    sys.exit(main())
