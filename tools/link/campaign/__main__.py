"""Run it as `python -m tools.link.campaign --kills 200 --seed 1 [--robots] [--router] [--json]`."""

import argparse
import json
import sys
import tempfile
from pathlib import Path

from tools.link.campaign.campaign import Campaign


def main() -> int:
    """Play a campaign, print its report; return 1 if something was violated."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--kills", type=int, default=200)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--robots", action="store_true", help="kill whole robots, too")
    parser.add_argument("--router", action="store_true", help="link through a router, and kill it, too")
    parser.add_argument("--json", action="store_true")
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory(prefix="link-campaign-") as folder:
        campaign = Campaign(
            Path(folder), arguments.seed, kills_robots=arguments.robots, has_router=arguments.router
        )
        report = campaign.play(arguments.kills)
    if arguments.json:
        print(json.dumps(report.as_data(), indent=2))
    else:
        print(report)
    return 1 if report.violations else 0


if __name__ == "__main__":
    sys.exit(main())
