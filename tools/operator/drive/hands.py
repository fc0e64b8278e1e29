"""How the operator drives: it chooses a way on the map that it sees, and holds and releases keys."""

import math
import time
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from playwright.sync_api import Page

from robbie_robots.workers.maps.navigation_grid import NavigationGrid
from robbie_robots.workers.navigation.path_planner import PathField
from tools.operator.drive.eyes import CELL_M, Sight, look, look_at_robot

CLEARANCE_M, BODY_M = 0.26, 0.2
AHEAD_M = 0.35
"""The operator steers to the point of its way that is this far ahead."""
ARRIVED_M = 0.2
TURN_FIRST_RAD = 0.6
"""The operator turns on the spot while the way is farther from the heading than this."""
STEER_RAD = 0.15
PLAN_S, STEP_S = 1.0, 0.06
STUCK_S, STUCK_M, BACK_S = 3.0, 0.08, 0.8
Place = tuple[float, float]


class NoWay(RuntimeError):
    """The map shows no way to the place."""


@dataclass
class Keys:
    """The keys that the operator holds down.

    Args:
        page: the page.
    """

    page: Page

    def __post_init__(self) -> None:
        self._held: frozenset[str] = frozenset()

    def hold(self, *keys: str) -> None:
        """Hold exactly these keys."""
        wanted = frozenset(keys)
        for key in self._held - wanted:
            self.page.keyboard.up(key)
        for key in wanted - self._held:
            self.page.keyboard.down(key)
        self._held = wanted


def way_on(sight: Sight, place: Place) -> NDArray[np.float64]:
    """Return a way `(N, 2)`, m, to a place; what is unknown counts as free, but as a detour.

    Raises:
        NoWay: there is none.
    """
    x, y, _ = sight.robot
    cells = np.where(sight.cells < 0, np.int8(0), sight.cells)
    grid = NavigationGrid(cells, CELL_M, sight.corner_m, CLEARANCE_M)
    grid = grid.around_robot((x, y), BODY_M, CLEARANCE_M)
    start, goal = grid.nearest(grid.drivable, (x, y), 0.5), grid.nearest(grid.drivable, place, 0.4)
    if start is None or goal is None:
        raise NoWay(f"robot or place {place} is inside a wall of the map")
    field = PathField(grid, start)
    if not np.isfinite(field.cost_m[goal]):
        raise NoWay(f"the map shows no way to {place}")
    return grid.middles_m(field.path(goal))


def keys_for(robot: tuple[float, float, float], way: NDArray[np.float64]) -> tuple[str, ...]:
    """Return the keys to hold for following a way."""
    here = np.array(robot[:2])
    nearest = int(np.argmin(np.hypot(*(way - here).T)))
    beyond = [point for point in way[nearest:] if math.dist(point, here) >= AHEAD_M]
    dx, dy = (beyond[0] if beyond else way[-1]) - here
    error = math.remainder(math.atan2(dy, dx) - robot[2], 2 * math.pi)
    turn = "KeyA" if error > 0 else "KeyD"
    if abs(error) > TURN_FIRST_RAD:
        return (turn,)
    return ("KeyW", turn) if abs(error) > STEER_RAD else ("KeyW",)


def drive_to(page: Page, place: Place, limit_s: float) -> bool:
    """Drive to a place. Return whether the map shows the robot there before the time is over."""
    keys, until_s = Keys(page), time.monotonic() + limit_s
    planned_s, moved_s, moved_from = -math.inf, time.monotonic(), (math.inf, math.inf)
    way = np.zeros((1, 2))
    try:
        while time.monotonic() < until_s:
            robot = look_at_robot(page)
            if math.dist(robot[:2], place) <= ARRIVED_M:
                return True
            now_s = time.monotonic()
            if now_s - planned_s > PLAN_S:
                way, planned_s = way_on(look(page), place), now_s
            if math.dist(robot[:2], moved_from) > STUCK_M:
                moved_s, moved_from = now_s, robot[:2]
            elif now_s - moved_s > STUCK_S:  # also when it turns: it does not take this long
                keys.hold("KeyS")
                time.sleep(BACK_S)
                moved_s = time.monotonic()
            keys.hold(*keys_for(robot, way))
            time.sleep(STEP_S)
        return False
    finally:
        keys.hold()
