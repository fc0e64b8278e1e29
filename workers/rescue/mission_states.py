"""The states of the rescue mission, and its settings."""

import math
from dataclasses import dataclass
from enum import StrEnum

from workers.state_machine import TimeOut


class MissionState(StrEnum):
    """What the robot does in a rescue mission."""

    WAIT = "waits for map, pose and navigation"
    EXPLORE = "drives to where the map ends"
    SEARCH = "drives to a wall not searched yet"
    LOOK = "stands and looks at that wall"
    APPROACH = "drives to a suspected victim"
    INSPECT = "stands and looks at the victim"
    ASK = "waits for the operator"
    HALT = "stands, until it may and can drive"
    PAUSE = "stands, until the operator resumes"
    RETURN = "drives home"
    DONE = "stands, its mission ended"


_S = MissionState
_WORK = {_S.EXPLORE, _S.SEARCH, _S.APPROACH}
_ALWAYS = {_S.HALT, _S.PAUSE, _S.RETURN, _S.DONE}
TRANSITIONS = {
    _S.WAIT: _WORK | _ALWAYS,
    _S.EXPLORE: _WORK | {_S.ASK} | _ALWAYS,
    _S.SEARCH: _WORK | {_S.LOOK, _S.ASK} | _ALWAYS,
    _S.LOOK: {_S.EXPLORE, _S.ASK} | _ALWAYS,
    _S.APPROACH: _WORK | {_S.INSPECT, _S.ASK} | _ALWAYS,
    _S.INSPECT: {_S.EXPLORE, _S.ASK} | _ALWAYS,
    _S.ASK: {_S.EXPLORE} | _ALWAYS,
    _S.HALT: {_S.EXPLORE, _S.PAUSE, _S.RETURN, _S.DONE},
    _S.PAUSE: {_S.EXPLORE, _S.HALT, _S.RETURN, _S.DONE},
    _S.RETURN: {_S.EXPLORE, _S.HALT, _S.PAUSE, _S.DONE},
    _S.DONE: set(),
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
        starts_by_itself: False: the robot stands until the operator starts the mission.
        time_limit_s: The robot is home again by then, whatever is left to do.
        reserve: The battery is not used below this ratio.
        home_m_per_s: How fast the robot comes home, at least.
        spare_s: It turns back so much earlier than it must.
        clearance_m: Ways keep this far from obstacles, as navigation's do. Were it more, what lies behind a
            passage that only navigation drives through would not be seen to be left to do.
        tight_clearance_m: Ways keep this far from obstacles where the robot stands too near to some already.
        body_radius_m: The robot's body is round; where it stands, no obstacle is.
        goal_clearance_m: Goals keep this far from obstacles: more, so that the next map shows a way back.
        plan_period_s: Goals are thought over this often.
        travel_s: A goal that is not reached in so long is given up.
        arrived_m: The robot is home when it is so near.
        silent_s: A camera that has said nothing for so long is out of order.
        min_frontier_m: Shorter frontiers are not worth a visit.
        min_wall_m: Neither are shorter pieces of unsearched wall.
    """

    starts_by_itself: bool = True
    time_limit_s: float = math.inf
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
