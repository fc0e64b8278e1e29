"""The states of an exploring robot, and the settings of its task."""

import math
from dataclasses import dataclass
from enum import StrEnum


class ExplorerState(StrEnum):
    """What an exploring robot does."""

    WAIT = "waits for map, pose and laser"
    EXPLORE = "drives to a frontier"
    RECOVER = "frees itself"
    RETURN = "drives home"
    DONE = "stands, its task ended"


TRANSITIONS = {
    ExplorerState.WAIT: {ExplorerState.EXPLORE, ExplorerState.RETURN},
    ExplorerState.EXPLORE: {
        ExplorerState.WAIT,
        ExplorerState.RECOVER,
        ExplorerState.RETURN,
        ExplorerState.DONE,
    },
    ExplorerState.RECOVER: {ExplorerState.WAIT, ExplorerState.EXPLORE, ExplorerState.RETURN},
    ExplorerState.RETURN: {ExplorerState.WAIT, ExplorerState.RECOVER, ExplorerState.DONE},
    ExplorerState.DONE: set(),
}


@dataclass(frozen=True)
class ExplorerSettings:
    """How the task is carried out.

    Attributes:
        clearance_m: Planned ways keep the robot's centre this far from obstacles.
        plan_period_s: A new way is planned this often.
        stale_s: Poses and sweeps older than this halt the robot.
        patience_s: A goal that has not come nearer for so long is given up.
        blocked_s: A robot that wants to drive and may not for so long frees itself.
        recover_s: How long it tries to.
        max_recoveries: After so many at one place it ends exploring, or returning.
        time_limit_s: After so long it ends exploring, whatever is left.
        returns_home: Whether it drives back to where it started.
    """

    clearance_m: float = 0.27
    plan_period_s: float = 0.5
    stale_s: float = 0.6
    patience_s: float = 4.0
    blocked_s: float = 1.0
    recover_s: float = 1.5
    max_recoveries: int = 4
    time_limit_s: float = math.inf
    returns_home: bool = True
