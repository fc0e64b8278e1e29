"""The robot's bumper."""

from hw.simulated_bumper import SimulatedBumper
from modules.simulated_world import SharedWorld, SimulatedDevice
from robbie_mp.messages import Bumper, Header
from robbie_mp.module import setting


class SimulatedBumperModule(SimulatedDevice):
    """A simulated bumper; publishes `Bumper` on topic `bumper`, whether it touches something or not."""

    period_s: float = setting(0.1, "time between messages", minimum=0.01)

    def setup(self) -> None:
        """Make the bumper; it feels nothing until it knows where it is."""
        self.world = SharedWorld(self, self.arena)
        self.bumper = SimulatedBumper(self.world.arena)

    def tick(self) -> None:
        """Publish what it touches."""
        truth = self.world.truth
        if truth is None:
            self.status = "waits for the simulated base"
            return
        self.bumper.arena = self.world.arena
        self.bumper.place(truth.pose, truth.stamp_s)
        pressed = self.bumper.read().pressed
        header = Header(stamp=self.world.stamp, frame_id="base_link")
        self.publish(Bumper(header=header, pressed=list(pressed)), topic="bumper")
        self.status = f"touches: {', '.join(pressed) or 'nothing'}"
