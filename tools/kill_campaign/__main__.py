"""`python -m tools.kill_campaign --kills N --seed S [--json]`: see docs/campaigns.md."""

import argparse
import json
import signal
import sys
import tempfile
from pathlib import Path
from typing import Any

from tools.kill_campaign.campaign import AttackPlan, run_campaign
from tools.robot import RobotTrouble

VIOLATED = 1


def main(arguments: list[str] | None = None) -> int:
    """Run the command line. The exit code is 0 if there is no violation, else 1."""
    parser = argparse.ArgumentParser(prog="python -m tools.kill_campaign", description=__doc__)
    parser.add_argument("--kills", type=int, default=100, help="processes to kill (100)")
    parser.add_argument("--seed", type=int, default=1, help="random seed of all choices (1)")
    parser.add_argument(
        "--longest-stop",
        type=float,
        default=10.0,
        metavar="S",
        help="maximum time for which a process is stopped (10)",
    )
    parser.add_argument(
        "--mean-pause", type=float, default=0.3, metavar="S", help="mean time between attacks (0.3)"
    )
    parser.add_argument(
        "--camera-rounds",
        type=int,
        default=3,
        help="how often to stop one viewer of a camera while another one hoards; 0: no camera (3)",
    )
    parser.add_argument(
        "--freeze-log", action="store_true", help="freeze the disk of the logs from time to time (as root)"
    )
    parser.add_argument("--keep", type=Path, metavar="DIR", help="empty folder for journals and logs")
    parser.add_argument("--json", action="store_true", help="print one JSON object")
    options = parser.parse_args(arguments)
    with tempfile.TemporaryDirectory(prefix="robbie-campaign-") as temporary:
        folder = options.keep or Path(temporary)
        try:
            plan = AttackPlan(
                options.kills,
                options.seed,
                mean_pause_s=options.mean_pause,
                longest_stop_s=options.longest_stop,
                freeze_log=options.freeze_log,
                rounds_with_camera=options.camera_rounds,
            )
            report = run_campaign(plan, folder)
        except RobotTrouble as trouble:
            report = {"violations": [str(trouble)]}
    print(json.dumps(report, indent=2) if options.json else as_text(report))
    return VIOLATED if report["violations"] else 0


def as_text(report: dict[str, Any], indent: str = "") -> str:
    """Return the report as text, with one line for each figure."""
    lines = []
    for name, value in report.items():
        if isinstance(value, dict):
            lines += [f"{indent}{name}:", as_text(value, indent + "  ")]
        elif name == "violations":
            lines += [f"{indent}violations: {len(value)}", *(f"{indent}  {text}" for text in value)]
        else:
            lines.append(f"{indent}{name}: {value}")
    return "\n".join(lines)


if __name__ == "__main__":
    signal.signal(signal.SIGTERM, signal.default_int_handler)  # the robot must not outlive the campaign
    sys.exit(main())
