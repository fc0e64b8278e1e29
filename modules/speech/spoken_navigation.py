"""Drives by spoken orders: to named places of the map, and stops; and learns places by name."""

import math

from robbie_mp import CallError, MessageHandling, Module, setting
from robbie_mp.messages import (
    AnnotateMap,
    CancelNavigation,
    MapAnnotated,
    NavigateTo,
    NavigationCancelled,
    NavigationResult,
    PointOfInterest,
    PoseStamped,
)
from robbie_robots.modules.devices.command_age import AHEAD_S, age_of, is_late
from robbie_robots.modules.speech.messages import Say, SpokenOrder


class SpokenNavigation(Module):
    """Does what `SpokenOrder`s say, and says what became of it (`Say`).

    - `go` with `place`: drives there (`NavigateTo`); the place is one of `MapAnnotations`.
    - `stop`: cancels every goal of the robot, also those of others (`CancelNavigation`).
    - `learn` with `place`: the place where the robot stands gets this name (`AnnotateMap`).

    Other orders are left to other modules. A spoken stop is no emergency stop: it takes as long as
    a person speaks and the robot understands, and noise may hide it.
    """

    max_pose_age_s: float = setting(1.0, "a place is learnt only from a pose that is not older", minimum=0.1)

    def setup(self) -> None:
        """Subscribe to orders and the pose."""
        self.pose: PoseStamped | None = None
        self.posed_s = -math.inf
        self.done = self.failed = 0
        self.advertise(Say)
        self.subscribe(SpokenOrder, self.on_order)
        self.subscribe(PoseStamped, self.on_pose, MessageHandling.KEEP_ONLY_NEWEST, topic="map_pose")

    def on_pose(self, pose: PoseStamped) -> None:
        """Remember where the robot is."""
        self.pose, self.posed_s = pose, self.monotonic_s()

    def on_order(self, order: SpokenOrder) -> None:
        """Do what the order says."""
        place = next((slot.words for slot in order.slots if slot.name == "place"), "")
        if order.order == "stop":
            self.call(CancelNavigation(), self.on_stopped, self.on_error)
        elif is_late(self):
            self.log.warning("ignored a late order: %s", order.text)
        elif order.order == "go" and place:
            self._say(f"I go to the {place}.")
            self.send_goal(
                NavigateTo(place=place), lambda result: self.on_arrived(place, result), self.on_error
            )
        elif order.order == "learn" and place:
            self._learn(place)

    def on_arrived(self, place: str, result: NavigationResult) -> None:
        """Say that the robot is there."""
        self.log.info("reached %s after %.1f s", place, result.duration_s)
        self._end(f"I am at the {place}.")

    def on_stopped(self, _reply: NavigationCancelled) -> None:
        """Say that the robot stands."""
        self._end("I stopped.")

    def on_learnt(self, place: str, _reply: MapAnnotated) -> None:
        """Say that the place is known."""
        self._end(f"This is the {place}.")

    def on_error(self, error: CallError) -> None:
        """Say that the order was not done."""
        self.failed += 1
        self.log.warning("an order was not done: %s", error)
        self._say("I could not do it.")
        self._show()

    def _learn(self, place: str) -> None:
        if self.pose is None or not self._is_fresh(self.pose):
            self.failed += 1
            self._say("I do not know where I am.")
            return
        self.call(
            AnnotateMap(places=[PointOfInterest(name=place, pose=self.pose.pose)]),
            lambda reply: self.on_learnt(place, reply),
            self.on_error,
        )

    def _is_fresh(self, pose: PoseStamped) -> bool:
        """Whether a pose is of now, by both clocks: that of stamps may be set."""
        age_s = age_of(self, pose.header.stamp)
        return age_s >= -AHEAD_S and max(age_s, self.monotonic_s() - self.posed_s) <= self.max_pose_age_s

    def _end(self, text: str) -> None:
        self.done += 1
        self._say(text)
        self._show()

    def _say(self, text: str) -> None:
        self.publish(Say(text=text))

    def _show(self) -> None:
        self.status = f"{self.done} orders done, {self.failed} failed"
