"""The small modules of the restart benchmark: one that publishes steadily, one that is killed."""

import time

IMPORT_BEGIN_NS = time.monotonic_ns()  # before the imports that a module's file usually begins with

import numpy as np  # noqa: E402

from robbie_mp import Module  # noqa: E402
from robbie_mp.messages import LaserScan  # noqa: E402
from tools.bench.restart_times import StartTimes  # noqa: E402

IMPORT_END_NS = time.monotonic_ns()


class Source(Module):
    """Publishes scans of 360 beams at 100 Hz."""

    period_s = 0.01

    def setup(self) -> None:
        """Prepare one scan."""
        self.ranges = np.ones(360, np.float32)

    def tick(self) -> None:
        """Publish it."""
        self.publish(LaserScan(ranges=self.ranges))


class Subject(Module):
    """Notes when it handled its first message."""

    def setup(self) -> None:
        """Subscribe."""
        self.times = StartTimes(self.output_directory, IMPORT_BEGIN_NS, IMPORT_END_NS)
        self.subscribe(LaserScan, self.on_scan)
        self.times.setup_ends()

    def on_scan(self, scan: LaserScan) -> None:
        """Write the times of this start."""
        self.times.message_comes()
