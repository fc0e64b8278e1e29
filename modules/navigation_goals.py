"""The client's side of navigation: sends goals one after another, and repeats what got lost."""

import math
from collections.abc import Callable
from enum import Enum
from functools import partial

import numpy as np
from numpy.typing import NDArray

from robbie_mp import CallError, CallRefused, GoalAborted, Header, Module, NoServer, SentGoal, Time
from robbie_mp.messages import (
    CancelNavigation,
    NavigateTo,
    NavigationCancelled,
    NavigationFeedback,
    NavigationResult,
)
from robbie_robots.modules.planar_messages import pose_stamped

CANNOT_DRIVE = ("STOPPED_", "EMERGENCY_")
REPEAT_S = 2.0
"""Time after which a goal that has ended otherwise than intended is sent again."""
CANCEL_TIMEOUT_S = 2.0


class Cancel(Enum):
    """Whether navigation has ended the module's goals, where the module wants to drive no more."""

    NOT_WANTED = 0
    ASKED = 1
    DONE = 2


class NavigationGoals:
    """Keeps navigation driving to the goal that its module wants, whatever dies meanwhile.

    Args:
        module: the module that wants to drive.
        arrived: called when the robot has reached the goal that was sent last.
        unreachable: called with the reason when navigation has given that goal up, or refused it.
        stopped: called with why the robot cannot drive, and with None when it can.
    """

    def __init__(
        self,
        module: Module,
        arrived: Callable[[], None],
        unreachable: Callable[[str], None],
        stopped: Callable[[str | None], None],
    ) -> None:
        self._module = module
        self._arrived, self._unreachable, self._stopped = arrived, unreachable, stopped
        self._goal: NDArray[np.float64] | None = None
        self._sent: SentGoal | None = None
        self._number = 0
        self._sent_s = -math.inf
        self._is_judged = False
        self._stands = False
        self._cancel = Cancel.NOT_WANTED
        self._cancel_s = -math.inf

    def drive_to(self, wanted: NDArray[np.float64] | None, pose: tuple[float, float, float]) -> None:
        """Send a goal if it is new, or if the last one has ended.

        Args:
            wanted: (3,), x, y (m) and heading (rad), map frame. None: stand still.
            pose: the robot's pose, which is sent to stand still.
        """
        self._cancel = Cancel.NOT_WANTED
        if wanted is not None:
            goal = wanted
        else:
            goal = self._goal if self._stands and self._goal is not None else np.array(pose)
        self._stands = wanted is None
        is_new = self._goal is None or not np.array_equal(goal, self._goal)
        if not is_new:
            assert self._sent is not None
            is_over = self._is_judged and self._stands
            if self._sent.is_active or is_over or self._time_s() - self._sent_s < REPEAT_S:
                return
        self._goal, self._sent_s = goal, self._time_s()
        self._is_judged = False
        self._number += 1
        header = Header(stamp=Time.from_nanoseconds(self._module.clock.now_ns()), frame_id="map")
        self._sent = self._module.send_goal(
            NavigateTo(pose=pose_stamped(goal, header)),
            partial(self._on_end, self._number),
            partial(self._on_end, self._number),
            partial(self._on_feedback, self._number),
        )

    def cancel(self, reason: str) -> None:
        """Have navigation end all goals of this module, of earlier processes as well, until it has done so.

        Meanwhile, the operator may send the robot to another goal.
        """
        now_s = self._time_s()
        is_asked = self._cancel is Cancel.ASKED and now_s - self._cancel_s < REPEAT_S
        if self._cancel is Cancel.DONE or is_asked:
            return
        self._cancel, self._cancel_s = Cancel.ASKED, now_s
        self._goal, self._number = None, self._number + 1
        self._module.call(
            CancelNavigation(client=self._module.name, reason=reason),
            self._on_cancelled,
            self._on_not_cancelled,
            timeout_s=CANCEL_TIMEOUT_S,
        )

    def _on_feedback(self, number: int, feedback: NavigationFeedback) -> None:
        """Pass on whether the robot can drive to the goal that was sent last."""
        if number == self._number:
            can_drive = not feedback.state.startswith(CANNOT_DRIVE)
            self._stopped(None if can_drive else f"{feedback.state}: {feedback.reason}")

    def _on_end(self, number: int, end: NavigationResult | CallError) -> None:
        """Pass on how the goal that was sent last has ended."""
        if number != self._number:
            return  # another goal was sent since then
        log = self._module.log
        log.debug("goal %s: %r", self._goal, end)
        self._is_judged = isinstance(end, NavigationResult | GoalAborted | CallRefused)
        if not self._is_judged:  # it is sent again
            log.warning("goal %s: %s: %s", self._goal, type(end).__name__, end)
            if isinstance(end, NoServer):
                self._stopped(str(end))
            return
        self._stopped(None)
        if isinstance(end, NavigationResult):
            self._arrived()
        else:
            self._unreachable(str(end))

    def _on_cancelled(self, _reply: NavigationCancelled) -> None:
        """Remember that navigation drives to no goal of this module."""
        if self._cancel is Cancel.ASKED:
            self._cancel = Cancel.DONE

    def _on_not_cancelled(self, error: CallError) -> None:
        """Report that navigation may still drive; `cancel` asks again."""
        self._module.log.warning("could not cancel the goal: %s: %s", type(error).__name__, error)

    def _time_s(self) -> float:
        return self._module.clock.monotonic_ns() / 1e9
