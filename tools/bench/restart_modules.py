"""The modules of the benchmark `restart`. They import little, so that the time is that of the restart."""

import numpy as np

from robbie_mp import Module
from robbie_mp.messages import LaserScan
from tools.journal import Journal

JOURNAL = "subject.journal"


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
    """Is killed; notes when each of its processes handles its first message."""

    def setup(self) -> None:
        """Subscribe to the scans."""
        self.has_begun = False
        self.journal = Journal(self.output_directory / JOURNAL)
        self.subscribe(LaserScan, self.on_scan)

    def on_scan(self, scan: LaserScan) -> None:
        """Note the first one."""
        if not self.has_begun:
            self.has_begun = True
            self.journal.note("F")
