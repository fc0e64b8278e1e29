"""The states of the rescue mission, and its settings."""

import math
from dataclasses import dataclass

from strenum import StrEnum

from robbie_mp.base.state_machine import TimeOut


class MissionState(StrEnum):
    """The states of a rescue mission."""

    WAIT = "waits for map, pose and navigation"
    EXPLORE = "drives to where the map ends"
    SEARCH = "drives to a wall not searched yet"
    LOOK = "stands and looks at that wall"
    APPROACH = "drives to a suspected victim"
    INSPECT = "stands and looks at the victim"
    ASK = "waits for the operator"
    GIVE_WAY = "lets another robot pass"
    HALT = "stands, until it may and can drive"
    PAUSE = "stands, until the operator resumes"
    RETURN = "drives home"
    DONE = "stands, its mission done"
    FAILED = "stands, its mission failed"
    ABORTED = "stands, its mission aborted"


_S = MissionState
_WORK = {_S.EXPLORE, _S.SEARCH, _S.APPROACH}
ENDS = frozenset({_S.DONE, _S.FAILED, _S.ABORTED})
"""In these the mission has ended; the operator may still call the robot home."""
_ALWAYS = {_S.GIVE_WAY, _S.HALT, _S.PAUSE, _S.RETURN} | ENDS
TRANSITIONS = {
    _S.WAIT: _WORK | _ALWAYS,
    _S.EXPLORE: _WORK | {_S.ASK} | _ALWAYS,
    _S.SEARCH: _WORK | {_S.LOOK, _S.ASK} | _ALWAYS,
    _S.LOOK: {_S.EXPLORE, _S.ASK} | _ALWAYS,
    _S.APPROACH: _WORK | {_S.INSPECT, _S.ASK} | _ALWAYS,
    _S.INSPECT: {_S.EXPLORE, _S.ASK} | _ALWAYS,
    _S.ASK: {_S.EXPLORE} | _ALWAYS,
    _S.GIVE_WAY: {_S.EXPLORE} | (_ALWAYS - {_S.GIVE_WAY}),
    _S.HALT: {_S.EXPLORE, _S.PAUSE, _S.RETURN} | ENDS,
    _S.PAUSE: {_S.EXPLORE, _S.HALT, _S.RETURN} | ENDS,
    _S.RETURN: {_S.EXPLORE, _S.GIVE_WAY, _S.HALT, _S.PAUSE} | ENDS,
    _S.DONE: {_S.RETURN},
    _S.FAILED: {_S.RETURN},
    _S.ABORTED: {_S.RETURN},
}
TIME_OUTS = {
    _S.LOOK: TimeOut(1.5, _S.EXPLORE),
    _S.INSPECT: TimeOut(4.0, _S.EXPLORE),
    _S.ASK: TimeOut(30.0, _S.EXPLORE),
}


@dataclass(frozen=True)
class MissionSettings:
    """How the mission is carried out.

    Attributes:
        starts_by_itself: False: the robot waits until the operator starts the mission.
        time_limit_s: The robot is home again by then, even if work is left.
        pause_stops_time: Whether the time stands while the operator has paused the robot. Most competitions'
            clocks run on.
        reserve: The battery is not used below this ratio.
        home_m_per_s: The lowest speed at which the robot comes home.
        spare_s: The robot turns back this much earlier than it must.
        clearance_m: Paths keep this far from obstacles, as navigation's do. With a larger value the mission
            would overlook the work behind a passage that navigation can still drive through.
        tight_clearance_m: Paths keep this far from obstacles where the robot is already too near to one.
        body_radius_m: Radius of the robot's round body. No obstacle is where the robot stands.
        goal_clearance_m: Goals keep this larger distance from obstacles, so that the next map still shows
            a way back.
        plan_period_s: Time between two planning steps.
        travel_s: The robot gives up a goal that it has not reached after this time.
        arrived_m: The robot counts as home within this distance.
        silent_s: A camera that has sent nothing for this long counts as failed.
        min_frontier_m: Shorter frontiers are not worth a visit.
        min_wall_m: Shorter pieces of unsearched wall are not worth a visit.
        gives_way_to: Robots that go first where their way meets this robot's.
    """

    starts_by_itself: bool = True
    time_limit_s: float = math.inf
    pause_stops_time: bool = False
    reserve: float = 0.15
    home_m_per_s: float = 0.25
    spare_s: float = 15.0
    clearance_m: float = 0.27
    tight_clearance_m: float = 0.22
    body_radius_m: float = 0.20
    goal_clearance_m: float = 0.3
    plan_period_s: float = 1.0
    travel_s: float = 60.0
    arrived_m: float = 0.45
    silent_s: float = 5.0
    min_frontier_m: float = 0.35
    min_wall_m: float = 0.3
    gives_way_to: tuple[str, ...] = ()
