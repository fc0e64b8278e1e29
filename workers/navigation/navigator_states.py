"""The states of a robot that drives to goals, and the settings of its task."""

from dataclasses import dataclass

from strenum import StrEnum

from robbie_mp.base.state_machine import TimeOut


class NavigatorState(StrEnum):
    """States of a robot that drives to goals."""

    IDLE = "no goal"
    DRIVE = "driving to the goal"
    ALIGN = "turning to the goal's heading"
    CLEAR_COSTMAP = "clearing obstacles seen by the laser"
    BACK_UP = "backing up"
    ROTATE = "turning to look around"
    ARRIVED = "at the goal"
    UNREACHABLE = "goal given up"
    STOPPED_NO_MAP = "stopped: no map"
    STOPPED_NO_POSE = "stopped: no pose"
    STOPPED_NO_LASER = "stopped: the laser is silent"
    STOPPED_HOLD = "stopped: waits for an order to go on"
    EMERGENCY_STOP = "emergency stop"


S = NavigatorState
RESTING = frozenset({S.IDLE, S.ARRIVED, S.UNREACHABLE})
RECOVERIES = (S.CLEAR_COSTMAP, S.BACK_UP, S.ROTATE)
STOPPED = frozenset(
    {S.STOPPED_NO_MAP, S.STOPPED_NO_POSE, S.STOPPED_NO_LASER, S.STOPPED_HOLD, S.EMERGENCY_STOP}
)
# A goal may start, be cancelled or become unreachable at any time, and the robot may be stopped at any time.
_ALWAYS = {S.IDLE, S.DRIVE, S.UNREACHABLE}
TRANSITIONS = {
    **dict.fromkeys(RESTING, _ALWAYS),
    S.DRIVE: {S.ALIGN, S.ARRIVED, *_ALWAYS, *RECOVERIES, *STOPPED},
    S.ALIGN: {S.ARRIVED, *_ALWAYS, *STOPPED},
    **{state: {*_ALWAYS, *STOPPED} for state in RECOVERIES},
    **{state: {*_ALWAYS, *(STOPPED - {state})} for state in STOPPED},
}


@dataclass(frozen=True)
class NavigatorSettings:
    """Settings of the navigator.

    Attributes:
        clearance_m: Planned paths keep the robot's centre this far from obstacles.
        tight_clearance_m: Smaller clearance, used if no other path leads to the goal.
        body_radius_m: Radius of the robot's round body. No obstacle is where the robot stands.
        snap_m: Maximum distance of the robot from a drivable place.
        tolerance_m: Maximum distance from the goal at which it counts as reached.
        heading_tolerance_rad: Tolerance of the goal's heading; pi or more: any heading.
        plan_period_s: Time between plans.
        stale_s: Poses and sweeps older than this stop the robot.
        patience_s: The robot starts a recovery after this time without progress.
        blocked_s: The robot starts a recovery after being blocked for this time.
        recover_s: Duration of backing up or turning.
        clear_s: Time for new sweeps after the live obstacles were cleared.
        max_recoveries: Number of recoveries without progress after which the goal is given up.
        max_detours: Number of much longer paths after which the goal is given up.
        align_s: Maximum time for turning to the goal's heading.
        enters_unknown: Paths may lead through places that were never seen if no other path leads to the goal.
    """

    clearance_m: float = 0.27
    tight_clearance_m: float = 0.22
    body_radius_m: float = 0.20
    snap_m: float = 0.4
    tolerance_m: float = 0.25
    heading_tolerance_rad: float = 0.15
    plan_period_s: float = 1.0
    stale_s: float = 0.4
    patience_s: float = 6.0
    blocked_s: float = 1.0
    recover_s: float = 2.0
    clear_s: float = 0.5
    max_recoveries: int = 6
    max_detours: int = 10
    align_s: float = 10.0
    enters_unknown: bool = False

    def time_outs(self) -> dict[NavigatorState, TimeOut[NavigatorState]]:
        """Return the states that end after a time."""
        return {
            S.CLEAR_COSTMAP: TimeOut(self.clear_s, S.DRIVE),
            S.BACK_UP: TimeOut(self.recover_s, S.DRIVE),
            S.ROTATE: TimeOut(self.recover_s, S.DRIVE),
            S.ALIGN: TimeOut(self.align_s, S.ARRIVED),
        }
