"""Kills roscore, the bridge and its ROS node at random. Needs ROS 1; docs/ros1.md says how to install it.

    python -m tools.ros1 --kills 50 --seed 1

The robot publishes scans all the time. After each kill, a new ROS node must hear them within 5 s. The exit
code is 1 if a promise was broken.
"""

import argparse
import statistics
import sys
import tempfile
from contextlib import closing
from pathlib import Path

from tools.ros1.ros import Ros
from tools.ros1.trial import robot_beside, run_trial


def main() -> int:
    """Run the command line."""
    parser = argparse.ArgumentParser(prog="python -m tools.ros1", description=__doc__)
    parser.add_argument("--kills", type=int, default=50)
    parser.add_argument("--seed", type=int, default=1)
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory(prefix="robbie-ros1-") as name, closing(Ros(Path(name))) as ros:
        ros.start()
        with robot_beside(ros, Path(name)) as robot:
            figures = run_trial(ros, robot, arguments.kills, arguments.seed)
    returned = sorted(figures.returned_s)
    print(f"kills: {figures.kills}")
    print(
        f"topics came back after {statistics.median(returned):.2f} s (median), {returned[-1]:.2f} s (longest)"
    )
    print(f"scans published {figures.scans[0]}, heard inside the robot {figures.scans[1]}")
    print(f"longest time between two scans {figures.longest_pause_s * 1e3:.0f} ms")
    for failure in figures.failures:
        print(f"FAILED: {failure}")
    return 1 if figures.failures else 0


if __name__ == "__main__":
    sys.exit(main())
