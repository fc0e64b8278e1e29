"""The client's side of navigation: sends goals one after another, and repeats what got lost."""

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from robbie_mp import CallError, GoalCancelled, Header, NoServer, Time
from robbie_mp.messages import (
    CancelNavigation,
    NavigateTo,
    NavigationCancelled,
    NavigationFeedback,
    NavigationResult,
)
from robbie_robots.modules.errand import Errand
from robbie_robots.modules.maps.planar_messages import pose_stamped
from robbie_robots.modules.moving_module import MovingModule

CANNOT_DRIVE = ("STOPPED_", "EMERGENCY_")
REPEAT_S = 2.0
"""Time after which a goal that has ended otherwise than intended is sent again."""


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
        module: MovingModule,
        arrived: Callable[[], None],
        unreachable: Callable[[str], None],
        stopped: Callable[[str | None], None],
    ) -> None:
        self._module = module
        self._arrived, self._unreachable, self._stopped = arrived, unreachable, stopped
        self._drive, self._cancel = Errand(module, REPEAT_S), Errand(module, REPEAT_S)
        self._goal: NDArray[np.float64] | None = None
        self._stands = self._is_judged = self._is_cancelled = False

    def drive_to(self, wanted: NDArray[np.float64] | None, pose: tuple[float, float, float]) -> None:
        """Send a goal if it is new, or if the last one has ended.

        Args:
            wanted: (3,), x, y (m) and heading (rad), map frame. None: stand still.
            pose: the robot's pose, which is sent to stand still.
        """
        self._cancel.forget()
        self._is_cancelled = False
        if wanted is not None:
            goal = wanted
        else:
            goal = self._goal if self._stands and self._goal is not None else np.array(pose)
        self._stands = wanted is None
        is_new = self._goal is None or not np.array_equal(goal, self._goal)
        if self._stands and self._is_judged and not is_new:
            return
        self._goal, self._is_judged = goal, self._is_judged and not is_new
        header = Header(stamp=Time.from_nanoseconds(self._module.clock.now_ns()), frame_id="map")
        navigate = NavigateTo(pose=pose_stamped(goal, header))
        self._drive.want(
            tuple(goal.tolist()), navigate, self._on_arrived, self._on_given_up, self._on_feedback
        )

    def cancel(self, reason: str) -> None:
        """Have navigation end all goals of this module, of earlier processes as well, until it has done so.

        Meanwhile, the operator may send the robot to another goal.
        """
        self._drive.forget()
        self._goal = None
        if not self._is_cancelled:
            cancel = CancelNavigation(client=self._module.name, reason=reason)
            self._cancel.want("no goal", cancel, self._on_cancelled)

    def _on_feedback(self, feedback: NavigationFeedback) -> None:
        """Pass on whether the robot can drive to the goal that was sent last."""
        can_drive = not feedback.state.startswith(CANNOT_DRIVE)
        self._stopped(None if can_drive else f"{feedback.state}: {feedback.reason}")

    def _on_arrived(self, _result: NavigationResult) -> None:
        self._is_judged = True
        self._stopped(None)
        self._arrived()

    def _on_given_up(self, error: CallError) -> None:
        """Pass on that the goal cannot be reached; one that others have ended is sent again."""
        if isinstance(error, NoServer):
            self._stopped(str(error))
        elif not isinstance(error, GoalCancelled):
            self._is_judged = True
            self._stopped(None)
            self._unreachable(str(error))

    def _on_cancelled(self, _reply: NavigationCancelled) -> None:
        """Remember that navigation drives to no goal of this module."""
        self._is_cancelled = True
