"""Messages of robots that work as a team."""

import math

from robbie_mp import DEFAULT, Duration, Header, Message, float64
from robbie_mp.messages import Point, Pose
from robbie_mp.messages.flaws import MAX_MAGNITUDE, Flaw, beyond, nan_in


class MapAlignment(Message, name="team_msgs/msg/MapAlignment", version=1):
    """Where the map of another robot lies in the map of this robot, and how sure that is."""

    header: Header = DEFAULT  # frame: this robot's map
    robot: str = DEFAULT  # the other robot
    pose: Pose = DEFAULT  # of the other robot's map; meaningless until it is known or sure
    is_known: bool = DEFAULT  # its start is known: the pose is used even if the maps do not confirm it yet
    is_sure: bool = DEFAULT  # the maps agree
    doubt: str = DEFAULT  # why it is not sure
    walls_m: float64 = DEFAULT  # length of wall that lies on walls of the other map
    agreement: float64 = DEFAULT  # 0 to 1: how much of the walls in the common area lies on walls
    ambiguity: float64 = DEFAULT  # 0 to 1: how well the best pose elsewhere fits, compared with this one

    def flaw(self) -> Flaw | None:
        """Return a number that is not finite."""
        return beyond(self, MAX_MAGNITUDE, "walls_m", "agreement", "ambiguity")


MAX_CLAIM_S = 60.0
"""Longest time for which a robot claims a goal without a word."""


class GoalClaim(Message, name="team_msgs/msg/GoalClaim", version=3):
    """Where a robot is and what it drives to, so that others do something else and keep out of its way.

    A robot renews its claim several times while it counts. It is not latched: one that joins later hears the
    next one, and never that of a robot that has died.
    """

    header: Header = DEFAULT  # frame: the robot's map
    pose: Pose = DEFAULT  # where the robot is
    drives: bool = DEFAULT  # whether it has a goal
    goal: Pose = DEFAULT  # where it drives
    has_target: bool = DEFAULT  # whether it has found work
    target: Point = DEFAULT  # a frontier, an unsearched wall or a victim
    way_m: float64 = math.inf  # cost of the way to the target
    is_working: bool = DEFAULT  # false: it is on its way home, or has ended
    has_home: bool = DEFAULT  # whether it knows where its home is
    home: Point = DEFAULT  # where it drives when no work is left
    vain_frontiers: list[Point] = DEFAULT  # it was there, and they are still frontiers: no robot needs to go
    vain_walls: list[Point] = DEFAULT  # it has looked at them, and could not search them
    valid_for: Duration = DEFAULT  # the claim ends then, unless renewed

    def flaw(self) -> Flaw | None:
        """Return a way that is no number, or a claim that never ends."""
        valid_s = self.valid_for.seconds
        if not 0.0 <= valid_s <= MAX_CLAIM_S:
            return Flaw("valid_for", valid_s, f"0 to {MAX_CLAIM_S:g} s; renew the claim")
        return nan_in(self, "way_m")
