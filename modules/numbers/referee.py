"""The referee of the simulation: judges where the robot truly is when it says that it has reached a sign."""

import json
from dataclasses import asdict
from typing import Any

from robbie_mp import setting
from robbie_robots.hw.simulation.number_referee import Visit, judge, wanted_order
from robbie_robots.modules.devices.simulated_world import SharedWorld, SimulatedDevice
from robbie_robots.modules.numbers.messages import SignsReached


class Referee(SimulatedDevice):
    """Judges each visit to a sign by the ground truth; writes `referee.json` to the run's results.

    The visits that it judged survive a restart.
    """

    period_s: float = setting(0.2, "time between updates of the status", minimum=0.02)

    def setup(self) -> None:
        """Enter the world; subscribe to what the robot says."""
        self.world = SharedWorld(self)
        self.visits: list[Visit] = []
        self.said: list[int] = []
        if self.restored is not None:
            self.visits = [Visit(**visit) for visit in self.restored["visits"]]
        self.subscribe(SignsReached, self.on_reached)

    def on_reached(self, message: SignsReached) -> None:
        """Take what the robot says; it stands there for a while."""
        self.said = message.digits.tolist()

    def tick(self) -> None:
        """Judge new visits, as soon as the true pose is known."""
        truth = self.world.truth
        if truth is None:
            self.status = "waiting for the simulated base"
            return
        for digit in self.said[len(self.visits) :]:
            visit = judge(self.world.arena, self.visits, digit, truth.pose, truth.stamp_s)
            self.visits.append(visit)
            self.log.info(
                "%d: %.2f m away, %s", digit, visit.distance_m, "counts" if visit.counts else "WRONG"
            )
            self.checkpoint({"visits": [asdict(each) for each in self.visits]})
        right = sum(visit.counts for visit in self.visits)
        self.status = (
            f"{right} of {len(wanted_order(self.world.arena))} right, {len(self.visits) - right} wrong"
        )

    def teardown(self) -> None:
        """Write the judgement."""
        order = wanted_order(self.world.arena)
        judgement: dict[str, Any] = {
            "order": order,
            "visits": [asdict(visit) | {"counts": visit.counts} for visit in self.visits],
            "is_right": len(self.visits) == len(order) and all(visit.counts for visit in self.visits),
        }
        self.write_result("referee.json", json.dumps(judgement) + "\n")
