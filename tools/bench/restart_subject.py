"""The modules of the restart benchmark: one that publishes steadily, one that is killed."""

import time

IMPORT_BEGIN_NS = time.monotonic_ns()  # before the imports that a module's file usually begins with

import json  # noqa: E402
import os  # noqa: E402

import numpy as np  # noqa: E402

from robbie_mp.messages import LaserScan  # noqa: E402
from robbie_mp.module import Module  # noqa: E402

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
    """Notes when it handled its first message, in a file of its process's own."""

    def setup(self) -> None:
        """Subscribe."""
        self.subscribe(LaserScan, self.on_scan)
        self.is_first = True
        self.setup_end_ns = time.monotonic_ns()

    def on_scan(self, scan: LaserScan) -> None:
        """Write the times of this start."""
        first_ns = time.monotonic_ns()
        if not self.is_first:
            return
        self.is_first = False
        times_ns = {
            "import_begin": IMPORT_BEGIN_NS,
            "import_end": IMPORT_END_NS,
            "setup_end": self.setup_end_ns,
            "first_message": first_ns,
        }
        unfinished = self.output_directory / f"{os.getpid()}.unfinished"
        unfinished.write_text(json.dumps(times_ns))
        unfinished.rename(self.output_directory / f"{os.getpid()}.json")
