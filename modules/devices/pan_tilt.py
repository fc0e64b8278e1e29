"""The robot's pan-tilt unit."""

import numpy as np

from hw.pan_tilt import PanTiltError, PanTiltLimits
from hw.simulation.pan_tilt import SimulatedPanTilt
from robbie_mp import Header, Module, Time, setting
from robbie_mp.messages import JointState, PanTiltCommand


class SimulatedPanTiltModule(Module):
    """A simulated pan-tilt unit: follows `PanTiltCommand`, publishes `JointState` on topic `pan_tilt`.

    The joints are `pan` and `tilt`. A restarted unit keeps the direction of the last tick.
    """

    rate_rad_per_s: float = setting(2.0, "speed of each joint", minimum=0.01)
    period_s: float = setting(0.05, "time between messages", minimum=0.01)

    def setup(self) -> None:
        """Create the unit, looking straight ahead or where it looked before the restart."""
        limits = PanTiltLimits(rate_rad_per_s=self.rate_rad_per_s)
        pan_rad, tilt_rad = (0.0, 0.0) if self.restored is None else self.restored["direction"]
        self.unit = SimulatedPanTilt(self._time_s, limits, (pan_rad, tilt_rad))
        self.subscribe(PanTiltCommand, self.on_command, optional=True)

    def on_command(self, command: PanTiltCommand) -> None:
        """Start moving to a direction."""
        try:
            self.unit.look(command.pan_rad, command.tilt_rad)
        except PanTiltError as error:
            self.log.error("ignored an invalid command from %s: %s", self.envelope.sender, error)

    def tick(self) -> None:
        """Publish and checkpoint the unit's direction."""
        state = self.unit.read()
        self.publish(
            JointState(
                header=Header(stamp=Time.from_nanoseconds(self.clock.now_ns())),
                name=["pan", "tilt"],
                position=np.array([state.pan_rad, state.tilt_rad]),
                velocity=np.array([state.pan_rad_per_s, state.tilt_rad_per_s]),
            ),
            topic="pan_tilt",
        )
        self.checkpoint({"direction": (state.pan_rad, state.tilt_rad)})
        self.status = f"pan {state.pan_rad:.2f} rad, tilt {state.tilt_rad:.2f} rad"

    def _time_s(self) -> float:
        return self.clock.monotonic_ns() / 1e9
