"""A simulated person who opens doors if the robot asks."""

import math

from robbie_mp import setting
from robbie_robots.modules.devices.simulated_world import DoorMoved, MoveDoor, SharedWorld, SimulatedDevice
from robbie_robots.modules.errand import Errand
from robbie_robots.modules.speech.messages import Say
from robbie_robots.workers.home.household import OPEN_DOOR

HEARS_M = 2.0
"""The robot is heard this far from a door."""


class SimulatedDoorkeeper(SimulatedDevice):
    """Opens the nearest door a while after the robot has asked for it near that door.

    It knows the truth about the world, and calls `MoveDoor` of the simulated base. A request that it has
    heard survives its restart.
    """

    period_s: float = setting(0.2, "time between looks at the clock", minimum=0.02)
    answer_s: float = setting(3.0, "time until the door begins to turn", minimum=0.0)

    def setup(self) -> None:
        """Enter the world; listen."""
        self.world = SharedWorld(self)
        self.doors = self.world.arena.doors
        self.door, self.due_s = "", math.inf
        self.errand = Errand(self)
        if self.restored:
            self.door, self.due_s = self.restored
        self.subscribe(Say, self.on_say, optional=True)

    def on_say(self, say: Say) -> None:
        """Hear a request."""
        truth = self.world.truth
        if truth is None or self.door or not say.text.startswith(OPEN_DOOR.format("").rstrip(".")):
            return
        away = {math.dist(door.middle_m, truth.pose[:2]): door.name for door in self.doors}
        if away and min(away) <= HEARS_M:
            self.door, self.due_s = away[min(away)], truth.stamp_s + self.answer_s
            self.checkpoint((self.door, self.due_s))

    def tick(self) -> None:
        """Open the door when it is time to."""
        truth = self.world.truth
        if not self.door:
            self.status = "waits"
            return
        self.status = f"goes to the door {self.door}"
        if truth is not None and truth.stamp_s >= self.due_s:
            self.errand.want(f"open {self.door}", MoveDoor(door=self.door, open=True), self._on_moved)

    def _on_moved(self, _reply: DoorMoved) -> None:
        self.log.info("opens the door %s", self.door)
        self.door = ""
        self.errand.forget()
        self.checkpoint(None)
