"""The states of an exploring robot, and the settings of its task."""

import math
from dataclasses import dataclass

from strenum import StrEnum


class ExplorerState(StrEnum):
    """States of an exploring robot."""

    WAIT = "waiting for map, pose and laser"
    EXPLORE = "driving to a frontier"
    RECOVER = "recovering"
    RETURN = "driving home"
    DONE = "done"


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
    """Settings of the task.

    Attributes:
        clearance_m: Planned paths keep the robot's centre this far from obstacles.
        plan_period_s: Time between plans.
        stale_s: Poses and sweeps older than this stop the robot.
        patience_s: A goal is abandoned after this time without progress.
        blocked_s: The robot starts a recovery after being blocked for this time.
        recover_s: Duration of a recovery.
        max_recoveries: After this number at one place the robot stops exploring or returning.
        time_limit_s: After this time exploring ends.
        returns_home: Whether the robot drives back to its start at the end.
    """

    clearance_m: float = 0.27
    plan_period_s: float = 0.5
    stale_s: float = 0.4
    patience_s: float = 4.0
    blocked_s: float = 1.0
    recover_s: float = 1.5
    max_recoveries: int = 4
    time_limit_s: float = math.inf
    returns_home: bool = True
