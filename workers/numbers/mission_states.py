"""The states of the robot that drives to numbers in order, and its settings."""

from dataclasses import dataclass

from strenum import StrEnum

from robbie_mp.base.state_machine import TimeOut


class NumbersState(StrEnum):
    """What the robot does."""

    WAIT = "waits for map, pose, signs and navigation"
    SHEET = "looks for a sheet with the order"
    LOOK = "stands and looks around"
    EXPLORE = "drives to where the map ends"
    SEARCH = "drives to where it can look at a post"
    VIEW = "stands and looks at that post"
    APPROACH = "drives to the next number"
    REACHED = "stands in front of it, and says so"
    HALT = "stands, until it can drive"
    DONE = "stands, its task ended"


_S = NumbersState
_TRAVELS = {_S.EXPLORE, _S.SEARCH, _S.APPROACH}
_ALWAYS = {_S.HALT, _S.DONE}
TRANSITIONS = {
    _S.WAIT: {_S.SHEET, _S.LOOK} | _ALWAYS,
    _S.SHEET: {_S.LOOK} | _ALWAYS,
    _S.LOOK: _TRAVELS | _ALWAYS,
    _S.EXPLORE: _TRAVELS | _ALWAYS,
    _S.SEARCH: _TRAVELS | {_S.VIEW} | _ALWAYS,
    _S.VIEW: _TRAVELS | {_S.VIEW} | _ALWAYS,
    _S.APPROACH: _TRAVELS | {_S.REACHED} | _ALWAYS,
    _S.REACHED: _TRAVELS | _ALWAYS,
    _S.HALT: {_S.LOOK, _S.SHEET, _S.DONE},
    _S.DONE: set(),
}
TIME_OUTS = {
    _S.LOOK: TimeOut(8.0, _S.EXPLORE),
    _S.VIEW: TimeOut(2.4, _S.EXPLORE),
    _S.REACHED: TimeOut(1.5, _S.EXPLORE),
}


@dataclass(frozen=True)
class NumbersSettings:
    """How the task is carried out.

    Attributes:
        time_limit_s: The task ends by then.
        sheet_images: Number of images without a sheet after which the robot assumes that there is none.
        clearance_m: Paths keep this far from obstacles, as navigation's do.
        tight_clearance_m: Paths keep this far from obstacles where the robot is already too near to one.
        goal_clearance_m: Goals keep this far from obstacles.
        body_radius_m: Radius of the robot's round body.
        stop_m: The robot stops between these distances in front of a sign.
        stop_rad: At most this far beside the direction in which it can be read.
        view_m: Distance from which the robot looks at a post.
        again_m: The same in later rounds, when it looks also from where a view is worse.
        reached_m: A sign counts as reached within this distance.
        travel_s: The robot gives up a goal that it has not reached after this time.
        plan_period_s: Time between two planning steps.
        min_frontier_m: Shorter frontiers are not worth a visit.
        max_rounds: How often the robot looks at all posts again before it gives up.
    """

    time_limit_s: float = 900.0
    sheet_images: int = 14
    clearance_m: float = 0.27
    tight_clearance_m: float = 0.22
    goal_clearance_m: float = 0.35
    body_radius_m: float = 0.20
    stop_m: tuple[float, float] = (0.65, 1.05)
    stop_rad: float = 0.7
    view_m: tuple[float, float] = (1.9, 2.9)
    again_m: tuple[float, float] = (1.2, 3.6)
    reached_m: float = 1.35
    travel_s: float = 60.0
    plan_period_s: float = 1.0
    min_frontier_m: float = 0.5
    max_rounds: int = 3
