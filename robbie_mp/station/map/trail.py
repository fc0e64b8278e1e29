"""The way that the robot has come, for the map and the 3-D view."""

from __future__ import annotations

import math
from collections import deque

from robbie_mp.messages import PoseStamped, TimeJump
from robbie_mp.station.watch.latest import MessageSource

STEP_M = 0.1
"""Distance between two points of a trail."""
MAX_POINTS = 1500
"""A longer trail loses its oldest points."""


class Trail:
    """Keeps the latest places of the robot. Used in the station's thread.

    Args:
        source: receives the robot's poses on the map (`map_pose`).

    Attributes:
        points: x and y, m, map frame, the oldest first.
        count: increases with each change.
    """

    def __init__(self, source: MessageSource):
        self.points: deque[tuple[float, float]] = deque(maxlen=MAX_POINTS)
        self.count = 0
        source.newest(PoseStamped, "map_pose").listen(self._on_pose)
        source.hear(TimeJump, lambda _jump: self._begin_anew())

    def _on_pose(self, message: PoseStamped) -> None:
        here = (message.pose.position.x, message.pose.position.y)
        if all(map(math.isfinite, here)) and (not self.points or math.dist(here, self.points[-1]) >= STEP_M):
            self.points.append(here)
            self.count += 1

    def _begin_anew(self) -> None:
        self.points.clear()
        self.count += 1
