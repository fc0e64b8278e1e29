"""The stock robot in the restart benchmark: mapping is killed while a simulated robot drives in a circle."""

import time

IMPORT_BEGIN_NS = time.monotonic_ns()

from robbie_mp import Duration, Module, Time  # noqa: E402, Time
from robbie_mp.messages import DriveCommand, LaserScan, Odometry  # noqa: E402
from robbie_robots.modules.mapping import Mapping  # noqa: E402
from tools.bench.restart_times import StartTimes  # noqa: E402

IMPORT_END_NS = time.monotonic_ns()


class Circling(Module):
    """Drives in a circle."""

    period_s = 0.2

    def tick(self) -> None:
        """Send the command again."""
        self.publish(
            DriveCommand(
                linear_m_per_s=0.2,
                angular_rad_per_s=0.4,
                valid_for=Duration(sec=1),
                based_on=Time.from_nanoseconds(self.clock.now_ns()),
            )
        )


class MappingSubject(Mapping):
    """The stock robot's mapping, which also records when it handles its first message."""

    def setup(self) -> None:
        """Set up, and restore the last checkpoint."""
        self.times = StartTimes(self.output_directory, IMPORT_BEGIN_NS, IMPORT_END_NS)
        super().setup()
        self.times.setup_ends()

    def on_odometry(self, odometry: Odometry) -> None:
        """Record the time, and map."""
        self.times.message_comes()
        super().on_odometry(odometry)

    def on_scan(self, scan: LaserScan) -> None:
        """Record the time, and map."""
        self.times.message_comes()
        super().on_scan(scan)
