"""Looks at a whole map: which place to look at next, until all of it was in sight."""

import math
from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

from robbie_robots.workers.home.seen_area import SeenArea

SEARCH_PERIOD_S = 0.5
"""Time between two looks at the map."""


class AreaSearch:
    """Remembers what was in sight since `begin`, and chooses where the robot looks next.

    Args:
        clock: Returns the time in s.

    Attributes:
        place: Where to look next, x and y, m, map frame; None: it is not chosen.
    """

    def __init__(self, clock: Callable[[], float]) -> None:
        self._clock = clock
        self._map: tuple[NDArray[np.int8], float, Sequence[float]] | None = None
        self.begin()

    def begin(self) -> None:
        """Forget what was in sight; the map stays."""
        self._area = SeenArea()
        self.place: tuple[float, float] | None = None
        self._looked_s = -math.inf

    @property
    def has_map(self) -> bool:
        """Return whether there is a map to search."""
        return self._map is not None

    def see_map(self, cells: NDArray[np.int8], resolution_m: float, corner_xy_m: Sequence[float]) -> None:
        """Take the newest map: see `SeenArea.see_map`."""
        self._map = cells, resolution_m, corner_xy_m

    def look(self, robot_xy_m: Sequence[float]) -> bool:
        """Note what is in sight of the robot, m, map frame.

        Returns:
            False if it is not time to do so, or there is no map.
        """
        if self._map is None or self._clock() - self._looked_s < SEARCH_PERIOD_S:
            return False
        self._looked_s = self._clock()
        self._area.see_map(*self._map)
        self._area.look_from(robot_xy_m)
        return True

    @property
    def needs_place(self) -> bool:
        """Return whether the next place must be chosen: there is none, or it was seen from afar."""
        return self.place is None or self._area.is_seen(self.place)

    def choose(self, robot_xy_m: Sequence[float], course_rad: float | None = None) -> None:
        """Choose the next place: see `SeenArea.next_place`. None if all was in sight."""
        self.place = self._area.next_place(robot_xy_m, course_rad)

    def leave_place(self) -> None:
        """Look elsewhere: the robot was at the place, or cannot get there."""
        if self.place is not None:
            self._area.leave_out(self.place)
            self.place = None
