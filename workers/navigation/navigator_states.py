"""The states of a robot that drives to goals, and the settings of its task."""

from dataclasses import dataclass
from enum import StrEnum

from workers.state_machine import TimeOut


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
    EMERGENCY_STOP = "emergency stop"


S = NavigatorState
RESTING = frozenset({S.IDLE, S.ARRIVED, S.UNREACHABLE})
RECOVERIES = (S.CLEAR_COSTMAP, S.BACK_UP, S.ROTATE)
STOPPED = frozenset({S.STOPPED_NO_MAP, S.STOPPED_NO_POSE, S.STOPPED_NO_LASER, S.EMERGENCY_STOP})
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
        clearance_m: Planned ways keep the robot's centre this far from obstacles.
        tight_clearance_m: This far, where no other way leads to the goal.
        body_radius_m: The robot's body is round; where it stands, no obstacle is.
        snap_m: The robot may be so far from a place where it can drive.
        tolerance_m: The goal counts as reached from a place so near to it.
        heading_tolerance_rad: How exactly the goal's heading is taken; pi or more: not at all.
        plan_period_s: A new way is planned this often.
        stale_s: Poses and sweeps older than this halt the robot.
        patience_s: Without progress for so long the robot frees itself.
        blocked_s: A robot that wants to drive and may not for so long frees itself.
        recover_s: How long it backs off or turns.
        clear_s: How long it looks anew after it has forgotten what the laser saw.
        max_recoveries: After so many without any progress between the goal is given up.
        max_detours: After so many ways that turned out much longer the goal is given up.
        align_s: Longer than that it does not turn to the goal's heading.
    """

    clearance_m: float = 0.27
    tight_clearance_m: float = 0.22
    body_radius_m: float = 0.20
    snap_m: float = 0.4
    tolerance_m: float = 0.25
    heading_tolerance_rad: float = 0.15
    plan_period_s: float = 1.0
    stale_s: float = 0.6
    patience_s: float = 6.0
    blocked_s: float = 1.0
    recover_s: float = 2.0
    clear_s: float = 0.5
    max_recoveries: int = 6
    max_detours: int = 10
    align_s: float = 10.0

    def time_outs(self) -> dict[NavigatorState, TimeOut[NavigatorState]]:
        """Return which states end by themselves."""
        return {
            S.CLEAR_COSTMAP: TimeOut(self.clear_s, S.DRIVE),
            S.BACK_UP: TimeOut(self.recover_s, S.DRIVE),
            S.ROTATE: TimeOut(self.recover_s, S.DRIVE),
            S.ALIGN: TimeOut(self.align_s, S.ARRIVED),
        }
