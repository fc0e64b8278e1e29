"""A module that records what the base reports about itself, and when."""

from robbie_mp import Module
from robbie_mp.messages import EmergencyStop, Odometry


class Witness(Module):
    """Writes lines: what, when it was published (ns, monotonic clock), and a number.

    `speed`: of the base (m/s); `asked`: 1 for an emergency stop that somebody wants, 0 for its release;
    `stopped`: 1 while the base is in one, 0 else.
    """

    def setup(self) -> None:
        """Listen."""
        self.file = (self.output_directory / "witness.txt").open("a")
        self.subscribe(Odometry, self.on_odometry, topic="ground_truth")
        self.subscribe(EmergencyStop, self.on_request, topic="emergency_stop")
        self.subscribe(EmergencyStop, self.on_stop, topic="emergency_stop_state")

    def on_request(self, request: EmergencyStop) -> None:
        """Write down what the operator wants."""
        self._write("asked", float(request.engaged))

    def on_odometry(self, odometry: Odometry) -> None:
        """Write down how fast the robot is."""
        self._write("speed", odometry.twist.twist.linear.x)

    def on_stop(self, state: EmergencyStop) -> None:
        """Write down whether the base stands and stays."""
        self._write("stopped", float(state.engaged))

    def _write(self, what: str, number: float) -> None:
        print(what, self.envelope.published_ns, number, file=self.file, flush=True)

    def teardown(self) -> None:
        """Close the file."""
        self.file.close()
