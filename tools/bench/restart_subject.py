"""The small modules of the restart benchmark: one publishes at a constant rate, the other one is killed."""

import time

IMPORT_BEGIN_NS = time.monotonic_ns()  # taken before the imports, with which a module's file usually begins

import numpy as np  # noqa: E402

from robbie_mp import Module  # noqa: E402
from robbie_mp.messages import LaserScan  # noqa: E402
from tools.bench.restart_times import StartTimes  # noqa: E402

IMPORT_END_NS = time.monotonic_ns()


class Source(Module):
    """Publishes scans of 360 beams at 100 Hz."""

    period_s = 0.01

    def setup(self) -> None:
        """Make one scan."""
        self.ranges = np.ones(360, np.float32)

    def tick(self) -> None:
        """Publish the scan."""
        self.publish(LaserScan(ranges=self.ranges))


class Subject(Module):
    """Records when it handles its first message."""

    def setup(self) -> None:
        """Subscribe to the scans."""
        self.times = StartTimes(self.output_directory, IMPORT_BEGIN_NS, IMPORT_END_NS)
        self.subscribe(LaserScan, self.on_scan)
        self.times.setup_ends()

    def on_scan(self, scan: LaserScan) -> None:
        """Write the times of this start to the file."""
        self.times.message_comes()
