"""Whether a no-go area that an operator draws cuts the robot off from its home."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from scipy import ndimage

from robbie_mp.messages import MapAnnotations, OccupancyGrid, Point, PoseStamped
from robbie_robots.modules.maps.planar_messages import map_cells, planar
from robbie_robots.workers.maps.map_annotations import forbid
from robbie_robots.workers.maps.navigation_grid import NavigationGrid
from robbie_robots.workers.rescue.mission_states import MissionSettings

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from robbie_mp.station.context import StationContext

HOME = "home"
WARNING = "This area cuts the robot off from home: it could not come back"
NEAR_M = 0.5
"""Where the robot and its home may be, beside the cells that the map shows as free."""


class WayHome:
    """Watches map, pose and home of a robot.

    Args:
        station: source of the messages.
    """

    def __init__(self, station: StationContext):
        messages = station.messages
        self._places = station.map.places
        self._grid = messages.newest(OccupancyGrid, station.settings.map_topic)
        self._pose = messages.newest(PoseStamped, "map_pose")
        self._annotations = messages.newest(MapAnnotations)

    def warning(self, corners: Sequence[Point]) -> str:
        """Return a warning if an area cuts off a way home that there is now; '' otherwise. It may take 0.1 s.

        Args:
            corners: of the area, m, map frame.
        """
        grid, pose = self._grid.message, self._pose.message
        home = next((one for one in self._places.places if one.name == HOME), None)
        if grid is None or pose is None or home is None or not len(grid.data):
            return ""
        known = self._annotations.message.no_go if self._annotations.message else []
        areas = [[(one.x, one.y) for one in area.corners] for area in known]
        cells, resolution_m, corner_m = map_cells(grid)
        ends = np.array([planar(pose.pose)[:2], planar(home.pose)[:2]])

        def leads_home(areas: list[list[tuple[float, float]]]) -> bool:
            there = forbid(cells, resolution_m, corner_m, areas)
            return is_way(there, resolution_m, corner_m, ends)

        drawn = [(one.x, one.y) for one in corners]
        return WARNING if leads_home(areas) and not leads_home([*areas, drawn]) else ""


def is_way(
    cells: NDArray[np.int8],
    resolution_m: float,
    corner_m: tuple[float, float],
    ends: NDArray[np.float64],
) -> bool:
    """Return whether free cells lead from one place to another, wide enough for the robot.

    Args:
        cells: occupancy `(H, W)` in percent, -1 unknown.
        resolution_m: edge of a cell.
        corner_m: outer corner of cell (0, 0), map frame.
        ends: `(2, 2)`, the two places, m, map frame.
    """
    grid = NavigationGrid(cells, resolution_m, corner_m, MissionSettings.tight_clearance_m)
    if any(grid.forbids(end) for end in ends):
        return False
    labels, _ = ndimage.label(grid.drivable, np.ones((3, 3)))
    found = [grid.nearest(grid.drivable, end, NEAR_M) for end in ends]
    return None not in found and labels[found[0]] == labels[found[1]]
