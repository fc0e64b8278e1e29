"""A module that records what the base reports, and when."""

from robbie_mp import Module
from robbie_mp.messages import EmergencyStop, Odometry


class Witness(Module):
    """Writes lines with the kind, the time of publication (ns, monotonic clock) and a number.

    `speed`: speed of the base (m/s). `asked`: 1 for a request of the emergency stop, 0 for its release.
    `stopped`: 1 while the base is stopped, otherwise 0.
    """

    def setup(self) -> None:
        """Subscribe to the base's messages."""
        self.file = (self.output_directory / "witness.txt").open("a")
        self.subscribe(Odometry, self.on_odometry, topic="ground_truth")
        self.subscribe(EmergencyStop, self.on_request, topic="emergency_stop")
        self.subscribe(EmergencyStop, self.on_stop, topic="emergency_stop_state")

    def on_request(self, request: EmergencyStop) -> None:
        """Record the operator's request."""
        self._write("asked", float(request.engaged))

    def on_odometry(self, odometry: Odometry) -> None:
        """Record the robot's speed."""
        self._write("speed", odometry.twist.twist.linear.x)

    def on_stop(self, state: EmergencyStop) -> None:
        """Record whether the base is stopped."""
        self._write("stopped", float(state.engaged))

    def _write(self, what: str, number: float) -> None:
        print(what, self.envelope.published_ns, number, file=self.file, flush=True)

    def teardown(self) -> None:
        """Close the file."""
        self.file.close()
