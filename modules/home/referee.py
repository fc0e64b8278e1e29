"""The simulation's referee of "follow me", and the simulated person's voice. Both know the truth."""

import json
import math
from dataclasses import asdict

from robbie_mp import Header, MessageHandling, setting
from robbie_robots.hw.simulation.follow_referee import FollowCounts, FollowReferee
from robbie_robots.modules.devices.simulated_world import SharedWorld, SimulatedDevice
from robbie_robots.modules.home.messages import Following
from robbie_robots.modules.speech.messages import Say, SpokenOrder
from robbie_robots.workers.home.follow import ARE_YOU_THERE, STAND_IN_FRONT
from robbie_robots.workers.home.follow_states import FOLLOWS

HEARS_M = 3.5
"""The person hears the robot up to this distance."""

AGAIN_S = 9.0
"""When the person says it again, until the robot follows."""


class Referee(SimulatedDevice):
    """Judges by the ground truth whether the robot follows the first person of the arena.

    Writes `referee.json`, and ends the run after a time. It survives a restart.
    """

    period_s: float = setting(0.1, "time between judgements", minimum=0.02)
    ends_after_s: float = setting(0.0, "time of the run after which it ends; 0: never", minimum=0.0)

    def setup(self) -> None:
        """Enter the world; subscribe to what the robot does."""
        self.world = SharedWorld(self)
        self.following = Following()
        counts = None if self.restored is None else FollowCounts(**self.restored)
        self.referee = FollowReferee(self.world.arena.start, counts)
        self.subscribe(Following, self.on_following, MessageHandling.KEEP_ONLY_NEWEST)

    def on_following(self, message: Following) -> None:
        """Take what the robot does."""
        self.following = message

    def tick(self) -> None:
        """Judge the present."""
        truth = self.world.truth
        if truth is None or not len(self.world.people):
            self.status = "waiting for the simulated base"
            return
        follows = self.following.state in {state.name for state in FOLLOWS}
        place = self.following.position
        followed = (place.x, place.y) if follows else None
        is_busy = self.following.state not in ("", "IDLE", "CHOOSE")
        self.referee.see(truth.stamp_s, truth.pose, self.world.people, followed, is_busy)
        counts = self.referee.counts
        self.checkpoint(asdict(counts))
        self.status = (
            f"{counts.task_s:.0f} s, {100 * counts.near_share:.0f} % within 3 m, "
            f"{counts.crossings} crossings, "
            f"{counts.wrong_s:.1f} s after the wrong person"
        )
        began_s = counts.began_s
        if self.ends_after_s and began_s is not None and truth.stamp_s - began_s >= self.ends_after_s:
            self.log.info("the run ends: %s", self.status)
            self.stop()

    def teardown(self) -> None:
        """Write the judgement."""
        counts = self.referee.counts
        judgement = asdict(counts) | {"near_share": counts.near_share, "state": self.following.state}
        self.write_result("referee.json", json.dumps(judgement) + "\n")


class SimulatedVoice(SimulatedDevice):
    """Speaks for the first person of the arena: tells the robot to follow, and answers if it asks.

    The person answers only near the robot, where it can hear the question. In place of sound, it publishes
    what the robot understands: `SpokenOrder`.
    """

    period_s: float = setting(0.2, "time between looks at the clock", minimum=0.02)
    order_s: float = setting(6.0, "when the person tells the robot to follow", minimum=0.0)
    answer_s: float = setting(1.5, "time until the person answers", minimum=0.0)

    def setup(self) -> None:
        """Enter the world; subscribe to what the robot says and does."""
        self.world = SharedWorld(self)
        self.began_s: float | None = None
        self.ordered_s = -math.inf
        self.answers_at_s = math.inf
        self.is_followed = bool(self.restored and self.restored["is_followed"])
        if self.restored:
            self.began_s = self.restored["began_s"]
        self.advertise(SpokenOrder)
        self.subscribe(Say, self.on_say, optional=True)
        self.subscribe(Following, self.on_following, MessageHandling.KEEP_ONLY_NEWEST)

    def on_following(self, message: Following) -> None:
        """Notice that the robot follows."""
        if not self.is_followed and message.state in {state.name for state in FOLLOWS}:
            self.is_followed = True
            self.checkpoint({"is_followed": True, "began_s": self.began_s})

    def on_say(self, say: Say) -> None:
        """Hear a question."""
        if say.text in (ARE_YOU_THERE, STAND_IN_FRONT) and self.world.truth is not None:
            away_m = math.dist(self.world.truth.pose[:2], self.world.people[0, :2])
            if away_m <= HEARS_M:
                self.answers_at_s = self.world.truth.stamp_s + self.answer_s

    def tick(self) -> None:
        """Speak when it is time to."""
        truth = self.world.truth
        if truth is None:
            self.status = "waiting for the simulated base"
            return
        if self.began_s is None:
            self.began_s = truth.stamp_s
            self.checkpoint({"is_followed": self.is_followed, "began_s": self.began_s})
        is_due = truth.stamp_s - self.began_s >= self.order_s
        if not self.is_followed and is_due and truth.stamp_s - self.ordered_s >= AGAIN_S:
            self.ordered_s = truth.stamp_s
            self._speak("follow", "follow me")
        if truth.stamp_s >= self.answers_at_s:
            self.answers_at_s = math.inf
            self._speak("here", "here I am")
        self.status = "is followed" if self.is_followed else "waits until the robot follows"

    def _speak(self, order: str, text: str) -> None:
        self.log.info('says "%s"', text)
        stamp = self.now()
        self.publish(SpokenOrder(header=Header(stamp=stamp), order=order, text=text))
