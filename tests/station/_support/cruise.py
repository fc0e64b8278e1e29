"""Copied into the workspace of tests: a module that turns the robot all the time."""

from robbie_mp import Duration, Header, Module, Time
from robbie_mp.messages import DriveCommand

TURN_RAD_PER_S = 0.3


class Cruise(Module):
    """Commands a slow turn on the spot."""

    period_s = 0.1

    def tick(self) -> None:
        stamp = Time.from_nanoseconds(self.now().nanoseconds)
        self.publish(
            DriveCommand(
                header=Header(stamp=stamp, frame_id="base_link"),
                angular_rad_per_s=TURN_RAD_PER_S,
                valid_for=Duration.from_nanoseconds(300_000_000),
                based_on=stamp,
            )
        )
