"""The robot's bumper."""

from robbie_mp import Header, setting
from robbie_mp.messages import Bumper
from robbie_robots.hw.bumper import PARTS
from robbie_robots.hw.simulation.bumper import SimulatedBumper
from robbie_robots.modules.devices.simulated_world import SharedWorld, SimulatedDevice


class SimulatedBumperModule(SimulatedDevice):
    """A simulated bumper; publishes `Bumper` on topic `bumper` at every tick, pressed or not."""

    period_s: float = setting(0.1, "time between messages", minimum=0.01)
    virtual_pressed: list[str] = setting(
        [], "parts that report contact even if they touch nothing", choices=PARTS, changeable=True
    )

    def setup(self) -> None:
        """Create the bumper; it reports nothing until the simulated base has published its pose."""
        self.world = SharedWorld(self)
        self.bumper = SimulatedBumper(self.world.arena)

    def tick(self) -> None:
        """Publish the parts that touch something or are pressed manually; the latter even without a base."""
        truth = self.world.truth
        if truth is None and not self.virtual_pressed:
            self.status = "waiting for the simulated base"
            return
        stamp, touched = self.now(), set(self.virtual_pressed)
        if truth is not None:
            stamp = self.world.stamp
            self.bumper.arena = self.world.arena
            self.bumper.place(truth.pose, truth.stamp_s)
            touched.update(self.bumper.read().pressed)
        pressed = [part for part in PARTS if part in touched]
        header = Header(stamp=stamp, frame_id="base_link")
        self.publish(Bumper(header=header, pressed=pressed), topic="bumper")
        by_hand = f", manually: {', '.join(self.virtual_pressed)}" if self.virtual_pressed else ""
        self.status = f"pressed: {', '.join(pressed) or 'nothing'}{by_hand}"
