"""Detects that a robot makes no progress towards its goal."""

import math

import numpy as np
from numpy.typing import ArrayLike, NDArray

SAME_GOAL_M = 0.5


class ProgressWatch:
    """Remembers when the remaining path last became shorter.

    Args:
        step_m: The path must become shorter by this much to count as progress.
    """

    def __init__(self, step_m: float = 0.1) -> None:
        self._step_m = step_m
        self.restart()

    def restart(self) -> None:
        """Forget the goal; the next one counts as new."""
        self._goal: NDArray[np.float64] | None = None
        self._best_m = math.inf
        self._since_s = 0.0

    def idle_s(self, goal_xy_m: ArrayLike, way_m: float, now_s: float) -> float:
        """Return for how long there has been no progress.

        Args:
            goal_xy_m: (x, y); one far from the last one is a new goal.
            way_m: The remaining length of the path.
            now_s: The time.
        """
        goal = np.asarray(goal_xy_m, float)
        if self._goal is None or np.hypot(*(goal - self._goal)) > SAME_GOAL_M:
            self._goal, self._best_m = goal, math.inf
        if way_m <= self._best_m - self._step_m:
            self._best_m, self._since_s = way_m, now_s
        return now_s - self._since_s
