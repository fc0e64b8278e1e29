"""Goals and poses that an operator sets on the map or in the 3-D view."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import TYPE_CHECKING, Any, NamedTuple

from robbie_mp.messages import NavigateTo, Point, Pose, PoseStamped, Quaternion
from robbie_mp.station.context import header_of_now
from robbie_mp.station.page.page import Page

if TYPE_CHECKING:
    from robbie_mp.module.clock import Clock
    from robbie_mp.station.page.requests import Asked

GOAL, NEXT_GOAL, INITIAL_POSE = "goal", "next_goal", "initial_pose"
KINDS = (GOAL, NEXT_GOAL, INITIAL_POSE)
MAX_GOALS = 50
"""Maximum number of goals that wait on one page."""


class Placement(NamedTuple):
    """A place that an operator has pressed."""

    kind: str
    """One of `KINDS`: a goal now, one for after the others, or where the robot is."""
    x_m: float
    """Position in the map frame; so is `y_m`."""
    y_m: float
    yaw_rad: float | None
    """Heading; None: away from the robot."""


def checked(sent: Any) -> Placement | None:
    """Return what a page's script has sent, or None if it is malformed."""
    try:
        kind, yaw_rad = str(sent["what"]), sent["yaw_rad"]
        numbers = [float(sent["x_m"]), float(sent["y_m"]), 0.0 if yaw_rad is None else float(yaw_rad)]
    except (KeyError, TypeError, ValueError):
        return None
    if kind not in KINDS or not all(map(math.isfinite, numbers)):
        return None
    return Placement(kind, numbers[0], numbers[1], None if yaw_rad is None else numbers[2])


def place(page: Page, clock: Clock, placement: Placement, robot: PoseStamped | None) -> Asked | None:
    """Send the goal or publish the pose that an operator has set.

    Args:
        page: the operator's page, which checks the role and shows how a goal ends.
        clock: tells the time.
        placement: the place.
        robot: the robot's pose on the map, for a goal without a heading; None if it is unknown.

    Returns:
        How the goal ends, in a while; None if there is none.
    """
    kind, x_m, y_m, yaw_rad = placement
    if yaw_rad is None:
        position = Point(x=x_m, y=y_m) if robot is None else robot.pose.position
        yaw_rad = math.atan2(y_m - position.y, x_m - position.x)
    pose = Pose(position=Point(x=x_m, y=y_m), orientation=Quaternion.from_yaw(yaw_rad))
    message = PoseStamped(header=header_of_now(clock, "map"), pose=pose)
    if kind != INITIAL_POSE:
        return page.ask(NavigateTo(pose=message), "the goal", "the robot is at the goal")
    page.publish(message, "the pose", INITIAL_POSE)
    return None


def goal_now(message: PoseStamped | None) -> PoseStamped | None:
    """Return the goal that the robot drives to; None if there is none, as a message without a frame says."""
    return message if message is not None and message.header.frame_id else None


class GoalList:
    """Goals that an operator has set for one after another.

    The list belongs to one page and ends with it. A goal that fails ends the list, because the operator
    counted on it.

    Args:
        send: sends a goal, like `place`.
        newest: returns the newest goal of the page, such as `Page.goal`, whichever tool has set it.

    Attributes:
        waiting: the goals that are not yet sent, in their order.
    """

    def __init__(self, send: Callable[[Placement], Asked | None], newest: Callable[[], Asked | None]):
        self._send = send
        self._newest = newest
        self._seen = self._current = newest()
        self.waiting: list[Placement] = []

    def start(self, placement: Placement) -> None:
        """Send a goal now. It takes the place of the one that the robot has, and of all that wait."""
        self.clear()
        self.add(placement)

    def add(self, placement: Placement) -> bool:
        """Add a goal; False if the list is full."""
        self.tick()  # otherwise a goal that has failed meanwhile would end this one
        if len(self.waiting) >= MAX_GOALS:
            return False
        self.waiting.append(placement)
        self.tick()
        return True

    def undo(self) -> None:
        """Remove the goal that was added last, unless the robot drives there already."""
        if self.waiting:
            self.waiting.pop()

    def remove(self, placement: Placement) -> None:
        """Remove a goal, unless the robot drives there already."""
        if placement in self.waiting:
            self.waiting.remove(placement)

    def move_up(self, placement: Placement) -> None:
        """Let the robot drive to a goal before the one that it follows now."""
        if placement in self.waiting and (at := self.waiting.index(placement)) > 0:
            self.waiting[at - 1 : at + 1] = [placement, self.waiting[at - 1]]

    def clear(self) -> None:
        """Forget all goals. The robot still drives to the one that it has."""
        self.waiting.clear()
        self._current = None

    def tick(self) -> None:
        """Send the next goal if the robot has reached the last one."""
        self._look()
        if self._current is not None and self._current.error is not None:
            self.clear()
        if self._current is not None and not self._current.has_ended:
            return
        self._current = self._send(self.waiting.pop(0)) if self.waiting else None
        if self._current is None:  # it was not sent: it came too late, for example
            self.waiting.clear()
        self._seen = self._newest()

    def _look(self) -> None:
        """A goal that was set elsewhere on the page, as in the 3-D view, takes the place of all."""
        if self._newest() is not self._seen:
            self.waiting.clear()
            self._seen = self._current = self._newest()
