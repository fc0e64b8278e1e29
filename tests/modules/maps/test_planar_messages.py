"""Messages as the types of planar workers."""

import math
import re
from pathlib import Path

import numpy as np
import pytest

from robbie_mp.messages import MapMetaData, OccupancyGrid, Point, Pose, Quaternion
from robbie_robots.modules.maps import planar_messages
from robbie_robots.modules.maps.planar_messages import map_cells
from robbie_robots.workers.maps.navigation_grid import NavigationGrid

MODULES = Path(planar_messages.__file__).parents[1]


def turned_room(yaw_rad: float) -> OccupancyGrid:
    """Return a free grid of 6 m x 4 m with a wall at 5 m of its x axis."""
    cells = np.zeros((40, 60), np.int8)
    cells[:, 50] = 100
    origin = Pose(position=Point(x=3.0, y=-2.0), orientation=Quaternion.from_yaw(yaw_rad))
    info = MapMetaData(resolution=0.1, width=60, height=40, origin=origin)
    return OccupancyGrid(info=info, data=cells.ravel())


@pytest.mark.parametrize("degrees", [0, 20, 90, -135])
def test_paths_are_planned_around_the_walls_of_a_turned_map(degrees: float) -> None:
    yaw_rad = math.radians(degrees)
    grid = NavigationGrid(*map_cells(turned_room(yaw_rad)), clearance_m=0.3)
    along, across = np.array([math.cos(yaw_rad), math.sin(yaw_rad)]), [-math.sin(yaw_rad), math.cos(yaw_rad)]
    place = np.array([3.0, -2.0]) + 2.0 * np.array(across)
    assert grid.drivable[grid.cell(place + 4.0 * along)]
    assert not grid.drivable[grid.cell(place + 4.9 * along)]
    distance_m = grid.obstacle_distance_m[grid.cell(place + 3.05 * along)]
    assert distance_m == pytest.approx(2.0, abs=0.1)


def test_no_module_takes_the_cells_of_a_map_in_another_way() -> None:
    reads_origin = re.compile(r"\.info\.origin")
    found = [path for path in MODULES.rglob("*.py") if reads_origin.search(path.read_text())]
    assert [path.name for path in found] == ["planar_messages.py"]
