"""Copied into the workspace of tests: records what the base reports."""

from robbie_mp import Module
from robbie_mp.messages import DriveCommand, Odometry


class Witness(Module):
    """Records each manual command and each odometry message: time (s), place (m), speed (m/s)."""

    def setup(self) -> None:
        self.file = (self.output_directory / "witness.txt").open("a")
        self.subscribe(DriveCommand, self.on_command, topic="manual")
        self.subscribe(Odometry, self.on_odometry, topic="ground_truth")

    def on_command(self, command: DriveCommand) -> None:
        self.write("command", command.linear_m_per_s, command.angular_rad_per_s)

    def on_odometry(self, odometry: Odometry) -> None:
        self.write("odometry", odometry.pose.pose.position.x, odometry.twist.twist.linear.x)

    def write(self, what: str, *numbers: float) -> None:
        print(what, self.envelope.published_ns / 1e9, *numbers, file=self.file, flush=True)

    def teardown(self) -> None:
        self.file.close()
