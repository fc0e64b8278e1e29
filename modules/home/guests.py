"""Simulated guests: they tell the robot their names, ask who is who, and note its answer beside the truth."""

import json
import math
from typing import Any

from robbie_mp import Header, setting
from robbie_robots.hw.pose import Pose
from robbie_robots.modules.devices.simulated_world import SharedWorld, SimulatedDevice
from robbie_robots.modules.errand import Errand
from robbie_robots.modules.home.messages import WhoIsWho, WhoIsWhoResult
from robbie_robots.modules.speech.messages import Say, SpokenOrder, SpokenSlot
from robbie_robots.workers.planar_pose import relative

ASK_AGAIN_S = 10.0
"""Time after which a question that got lost is asked again."""

AGAIN_S = 12.0
"""A guest who was not understood speaks again."""

FRONT_M = 2.0
"""Guests speak to a robot that is at most this far away."""


class SimulatedGuests(SimulatedDevice):
    """Speaks for the people of the arena who tell the robot their names; then asks who is who.

    A guest says "my name is …" while standing in front of the robot, until the robot greets the guest by
    this name. In place of sound, the module publishes what the robot understands: `SpokenOrder`. It writes
    where everybody truly is, and what the robot has answered, to `guests.json`, and ends the run.
    """

    period_s: float = setting(0.2, "time between looks at the people", minimum=0.02)
    introduce: list[str] = setting([], "names of those who tell their names")
    asks_s: float = setting(55.0, "time of the run at which somebody asks who is who", minimum=0.0)

    def setup(self) -> None:
        """Enter the world; listen to the robot."""
        kept = self.restored or {"began_s": None, "known": [], "spoke_s": {}, "answer": None}
        self.world = SharedWorld(self)
        self.began_s: float | None = kept["began_s"]
        self.known: list[str] = kept["known"]
        self.spoke_s: dict[str, float] = kept["spoke_s"]
        self.answer: dict[str, Any] | None = kept["answer"]
        self.errand = Errand(self, ASK_AGAIN_S)
        self.advertise(SpokenOrder)
        self.subscribe(Say, self.on_say, optional=True)

    def on_say(self, say: Say) -> None:
        """Hear a greeting."""
        for name in self.introduce:
            if say.text == f"Hello {name}." and name not in self.known:
                self.known.append(name)
                self._keep()

    def tick(self) -> None:
        """Speak when it is time to."""
        truth = self.world.truth
        if truth is None or not len(self.world.people):
            self.status = "waiting for the simulated base"
            return
        if self.began_s is None:
            self.began_s = truth.stamp_s
            self._keep()
        self._introduce(truth.stamp_s, truth.pose)
        if truth.stamp_s - self.began_s >= self.asks_s and self.answer is None:
            self.errand.want("who is who", WhoIsWho(), self._on_answer)
        self.status = f"{len(self.known)} of {len(self.introduce)} guests are known"

    def _introduce(self, now_s: float, robot: Pose) -> None:
        """Let a guest who stands in front of the robot tell the name."""
        people = zip(self.world.arena.people, self.world.people.tolist(), strict=True)
        for name, (x, y, _, _, stride) in ((person.name, shown) for person, shown in people):
            if name not in self.introduce or name in self.known or stride > 0.0:
                continue
            is_due = now_s - self.spoke_s.get(name, -math.inf) >= AGAIN_S
            if is_due and math.dist((x, y), robot[:2]) <= FRONT_M:
                self.spoke_s[name] = now_s
                self._keep()
                self._speak(name)

    def _speak(self, name: str) -> None:
        text = f"my name is {name}"
        self.log.info('a guest says "%s"', text)
        header = Header(stamp=self.now())
        slots = [SpokenSlot(name="name", words=name)]
        self.publish(SpokenOrder(header=header, order="name", text=text, slots=slots))

    def _on_answer(self, result: WhoIsWhoResult) -> None:
        found = [
            {"name": one.name, "x_m": one.position.x, "y_m": one.position.y, "faces": one.faces}
            for one in result.persons
        ]
        self._end({"found": found, "duration_s": result.duration_s})

    def _end(self, answer: dict[str, Any]) -> None:
        """Note where everybody is at this moment, and end the run."""
        people = zip(self.world.arena.people, self.world.people.tolist(), strict=True)
        truth = []
        for person, (x, y, *_) in people:
            x_m, y_m, _ = relative(self.world.arena.start, (x, y, 0.0)).tolist()
            truth.append({"name": person.name, "x_m": x_m, "y_m": y_m})
        self.answer = answer | {"truth": truth, "known": self.known}
        self._keep()
        self.stop()

    def _keep(self) -> None:
        self.checkpoint(
            {"began_s": self.began_s, "known": self.known, "spoke_s": self.spoke_s, "answer": self.answer}
        )

    def teardown(self) -> None:
        """Write the answer and the truth."""
        told = self.answer or {
            "found": [],
            "duration_s": 0.0,
            "reason": "no answer",
            "truth": [],
            "known": self.known,
        }
        self.write_result("guests.json", json.dumps(told) + "\n")
